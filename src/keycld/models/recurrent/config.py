"""Settings of the autoregressive model."""

import dataclasses
from typing import TYPE_CHECKING

from keycld._errors import KeycldError, unknown
from keycld.models.config import ModelConfig, at_least_one
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from jaxtyping import PRNGKeyArray

    from keycld.models.recurrent.model import AR
    from keycld.stages import Stage

CELLS = ("vanilla", "lstm", "gru")


@dataclasses.dataclass(frozen=True)
class RecurrentConfig(ModelConfig):
    """AR of "Which priors matter?": encode a picture, pass recurrent cells, decode the next picture."""

    cell: str = "vanilla"
    """Kind of the recurrent cells: `vanilla`, `lstm` or `gru`."""
    layers: int = 5
    """Recurrent cells, one after the other."""
    hidden: int = 250
    """Units of every cell but the last."""
    latent: int = 32
    """Numbers that a picture is encoded to, and units of the last cell; even."""
    channels: int = 64
    """Channels of the convolutions."""
    taper: bool = False
    """Whether the decoder halves its channels each time it doubles the picture: a sixth of the work."""
    given: int = 5
    """Frames that a prediction starts from, at least; with more of them, all are used."""
    window: int = 60
    """Frames of a training window; shorter trajectories are used whole."""
    rendered: int = 0
    """Random predicted frames of each window that a step renders and compares; 0: all of them."""
    rate: float = 1.5e-4
    """Learning rate of Adam."""
    steps: int = 500_000
    """Optimiser steps."""
    batch: int = 128
    """Windows a step."""
    frames_at_once: int = 512
    """Frames of 32×32 pixels that training encodes and renders in parallel, about 2 MB each; of larger ones, fewer."""

    def __post_init__(self) -> None:
        """Refuse settings that do not fit together."""
        super().__post_init__()
        at_least_one(self, "layers", "hidden", "channels", "given", "batch", "steps", "frames_at_once")
        if self.cell not in CELLS:
            raise unknown("cell", self.cell, CELLS)
        if self.latent < 2 or self.latent % 2:
            raise KeycldError(f"setting latent is an even number of at least 2, not {self.latent}.")
        if self.window < 2:
            raise KeycldError(f"a training window has 2 frames or more, not {self.window}.")

    @property
    def context(self) -> int:
        """As many frames as are given."""
        return self.given

    def build(self, scene: Scene, key: "PRNGKeyArray") -> "AR":
        """Build encoder, cells and decoder."""
        from keycld.models.recurrent import model

        return model.build(self, scene, key)

    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return one stage that trains everything, with a validation score at its end."""
        from keycld.data import Windows
        from keycld.models.recurrent.losses import NextFrameLoss
        from keycld.stages import Group, Stage, whole

        at_once = max(1, 32 * 32 * self.frames_at_once // (scene.height * scene.width))
        return (
            Stage(
                name="train",
                steps=self.steps,
                sampler=Windows(self.batch, min(self.window, scene.frames)),
                loss=NextFrameLoss(self.rendered, at_once),
                groups=(Group("model", whole, self.rate),),
                validate=True,
            ),
        )
