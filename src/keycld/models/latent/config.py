"""What all models of the family share: how images become a latent vector, and how they are trained."""

import dataclasses
from typing import TYPE_CHECKING

from keycld._errors import KeycldError, unknown
from keycld.models.config import ModelConfig, at_least_one
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from keycld.stages import Stage

REGIMES = ("forward", "forward_backward")
OBJECTIVES = ("elbo", "geco")
PARTS = ("window", "frame")


@dataclasses.dataclass(frozen=True)
class LatentConfig(ModelConfig):
    """The variational autoencoder of "Which priors matter?" around latent dynamics."""

    given: int = 5
    """Consecutive frames that the encoder sees, stacked as channels; a prediction starts from as many."""
    latent: int = 32
    """Size of the latent vector; even."""
    channels: int = 64
    """Channels of the convolutions."""
    hidden: int = 250
    """Units of a hidden layer of the dynamics' networks."""
    depth: int = 4
    """Hidden layers of the dynamics' networks."""
    interval: float = 0.125
    """Time between two frames in the dynamics' own unit, whatever the data's dt."""
    regime: str = "forward"
    """Direction of training. `forward`: the state belongs to the last given frame. `forward_backward`: it belongs to
    the middle one, and half of the windows are rolled out from their first frames, half from their last ones."""
    targets: int = 60
    """Target frames of a training window: in regime `forward` from the last given frame on; in `forward_backward` after
    the given ones, which are targets too. Shorter trajectories are used whole."""
    objective: str = "elbo"
    """What is minimised. `elbo`: −log-likelihood plus `beta` times the KL divergence. `geco`: the KL divergence, with
    the mean squared error held at `kappa`."""
    beta: float = 1.0
    """Weight of the KL divergence in `elbo`."""
    kl_against: str = "window"
    """Next to which likelihood `beta` weighs the KL divergence. `window`: that of all frames, as in the released code.
    `frame`: that of one frame, the mean over the window, as in eq. (3)."""
    kappa: float = 0.001
    """Mean squared error a value that `geco` asks for."""
    rate: float = 1.5e-4
    """Learning rate of Adam."""
    steps: int = 500_000
    """Optimiser steps."""
    batch: int = 128
    """Windows a step."""
    frames_at_once: int = 512
    """Frames of 32×32 pixels that training renders in parallel, about 2 MB each; of larger ones, fewer."""

    def __post_init__(self) -> None:
        """Refuse settings that do not fit together."""
        super().__post_init__()
        at_least_one(self, "given", "channels", "hidden", "depth", "targets", "batch", "frames_at_once")
        for name, choices in (("regime", REGIMES), ("objective", OBJECTIVES), ("kl_against", PARTS)):
            if getattr(self, name) not in choices:
                raise unknown(name, getattr(self, name), choices)
        if self.latent < 2 or self.latent % 2:
            raise KeycldError(f"setting latent is an even number of at least 2, not {self.latent}.")
        if self.both_ways and (self.given % 2 == 0 or self.batch < 2):
            raise KeycldError(
                "regime forward_backward takes an odd number of given frames, which have a middle, and a batch of 2 or "
                f"more, not given {self.given} and batch {self.batch}."
            )

    @property
    def both_ways(self) -> bool:
        """Whether training rolls out backward too."""
        return self.regime == "forward_backward"

    @property
    def context(self) -> int:
        """As many frames as are given."""
        return self.given

    @property
    def anchor(self) -> int:
        """Which given frame the state belongs to."""
        return self.given // 2 if self.both_ways else self.given - 1

    def window(self, scene: Scene) -> int:
        """Return how many frames a training window has.

        Raises:
            KeycldError: the trajectories have no frames besides the given ones.
        """
        if scene.frames <= self.given:
            raise KeycldError(
                f"this model is given {self.given} frames and needs more to train on, but trajectories have "
                f"{scene.frames}: make longer ones or set given to fewer."
            )
        # The anchor is a target too, and so are all given frames where training rolls out backward.
        return min(self.targets + (self.given if self.both_ways else self.anchor), scene.frames)

    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return one stage that trains everything, with a validation score at its end."""
        from keycld.data import Windows
        from keycld.models.latent.losses import ELBOLoss, GECOLoss
        from keycld.stages import Group, Stage

        at_once = max(1, 32 * 32 * self.frames_at_once // (scene.height * scene.width))
        if self.objective == "geco":
            loss = GECOLoss(self.kappa, self.rate, self.both_ways, at_once)
        else:
            loss = ELBOLoss(self.beta, self.kl_against == "frame", self.both_ways, at_once)
        return (
            Stage(
                name="train",
                steps=self.steps,
                sampler=Windows(self.batch, self.window(scene)),
                loss=loss,
                groups=(Group("model", lambda m: m, self.rate),),
                validate=True,
            ),
        )
