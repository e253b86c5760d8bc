"""What all models of the family share: how images become a latent vector, and how they are trained."""

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from keycld._errors import KeycldError, unknown
from keycld.models.config import ModelConfig, at_least_one
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from keycld.stages import AbstractLoss, AbstractStatefulLoss, Stage

REGIMES = ("forward", "forward_backward", "given")
OBJECTIVES = ("elbo", "geco")
PARTS = ("window", "frame")


@dataclasses.dataclass(frozen=True)
class LatentConfig(ModelConfig):
    """The variational autoencoder of "Which priors matter?" around latent dynamics."""

    REVERSIBLE: ClassVar[bool] = True
    """Whether the dynamics run backward."""

    given: int = 5
    """Consecutive frames that the encoder sees, stacked as channels; a prediction starts from as many."""
    latent: int = 32
    """Size of the latent vector; even."""
    channels: int = 64
    """Channels of the convolutions."""
    taper: bool = False
    """Whether the decoder halves its channels each time it doubles the picture: a sixth of the work."""
    hidden: int = 250
    """Units of a hidden layer of the dynamics' networks."""
    depth: int = 4
    """Hidden layers of the dynamics' networks."""
    interval: float = 0.125
    """Time between two frames in the dynamics' own unit, whatever the data's dt."""
    regime: str = "forward"
    """Direction of training. `forward`: the state belongs to the last given frame. `forward_backward`: it belongs to
    the middle one, and half of the windows are rolled out from their first frames, half from their last ones. `given`:
    it belongs to the last given frame, and the motion is rolled back over the given frames, which alone are targets."""
    targets: int = 60
    """Target frames of a training window: in regime `forward` from the last given frame on; in `forward_backward` after
    the given ones, which are targets too. Shorter trajectories are used whole."""
    rendered: int = 0
    """Random target frames of each window that a step renders and compares; 0: all of them."""
    objective: str = "elbo"
    """What is minimised. `elbo`: −log-likelihood plus `beta` times the KL divergence. `geco`: the KL divergence, with
    the mean squared error held at `kappa`."""
    beta: float = 1.0
    """Weight of the KL divergence in `elbo`."""
    kl_against: str = "window"
    """Likelihood that the KL divergence is weighed against. `window`: the sum over all target frames, as in the
    released code. `frame`: the mean over the frames, as in eq. (3); the KL divergence then weighs as many times more as
    a window has target frames.
    """
    kappa: float = 0.001
    """Mean squared error a value that `geco` asks for."""
    consistency: float = 0.0
    """Weight of the squared distance between a rolled-out state and the state that the encoder infers at the same
    frame, relative to the variance of such states. 0: no such term, as in the paper.
    """
    rate: float = 1.5e-4
    """Learning rate of Adam."""
    steps: int = 500_000
    """Optimiser steps."""
    batch: int = 128
    """Windows a step."""
    frames_at_once: int = 512
    """Frames of 32×32 pixels that a device renders in parallel in training, about 2 MB each; of larger ones, fewer."""

    def __post_init__(self) -> None:
        """Refuse settings that do not fit together."""
        super().__post_init__()
        at_least_one(self, "given", "channels", "hidden", "depth", "targets", "batch", "steps", "frames_at_once")
        for name, choices in (("regime", REGIMES), ("objective", OBJECTIVES), ("kl_against", PARTS)):
            if getattr(self, name) not in choices:
                raise unknown(name, getattr(self, name), choices)
        if self.latent < 2 or self.latent % 2:
            raise KeycldError(f"setting latent is an even number of at least 2, not {self.latent}.")
        if self.regime == "given" and self.consistency:
            raise KeycldError("regime given has no frames beyond the given ones to compare: set consistency to 0.")
        if self.consistency and self.batch < 2:
            raise KeycldError("one window has no variance: set batch to 2 or more, or consistency to 0.")
        if self.regime != "forward" and not self.REVERSIBLE:
            raise KeycldError(f"model {self.model} cannot run backward, so its regime is forward, not {self.regime}.")
        if self.both_ways and (self.given % 2 == 0 or self.batch < 2):
            raise KeycldError(
                "regime forward_backward takes an odd number of given frames, which have a middle, and a batch of 2 or "
                f"more, not given {self.given} and batch {self.batch}."
            )

    def migrated(self, settings: Mapping[str, Any], version: int) -> Mapping[str, Any]:
        """Return settings of schema 5 and earlier, in which motions were not compared with the encoder."""
        return settings if version > 5 else {**settings, "consistency": 0.0}

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

    @property
    def given_are_targets(self) -> bool:
        """Whether the frames before the state's are targets too."""
        return self.regime != "forward"

    def window(self, scene: Scene, targets: int | None = None) -> int:
        """Return how many frames a training window has.

        Args:
            scene: sizes of the data.
            targets: target frames; by default those of the settings.

        Raises:
            KeycldError: the trajectories have no frames besides the given ones.
        """
        if self.regime == "given" and scene.frames >= self.given:
            return self.given
        if scene.frames <= self.given:
            raise KeycldError(
                f"this model is given {self.given} frames and needs more to train on, but trajectories have "
                f"{scene.frames}: make longer ones or set given to fewer."
            )
        # The anchor is a target too, and so are all given frames where training rolls out backward.
        begin = self.given if self.both_ways else self.anchor
        return min((self.targets if targets is None else targets) + begin, scene.frames)

    def loss(self, scene: Scene, cross_entropy: float | None = None) -> "AbstractLoss | AbstractStatefulLoss":
        """Return what a stage minimises, with this weight of the pixels' cross-entropy."""
        from keycld.models.latent.losses import ELBOLoss, GECOLoss, Targets

        at_once = max(1, 32 * 32 * self.frames_at_once // (scene.height * scene.width))
        targets = Targets(self.both_ways, self.given_are_targets, self.rendered, at_once, cross_entropy)
        consistency = self.consistency or None
        if self.objective == "geco":
            return GECOLoss(self.kappa, self.rate, targets, consistency)
        return ELBOLoss(self.beta, self.kl_against == "frame", targets, consistency)

    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return one stage that trains everything, with a validation score at its end."""
        from keycld.data import Windows
        from keycld.stages import Group, Stage, whole

        return (
            Stage(
                name="train",
                steps=self.steps,
                sampler=Windows(self.batch, self.window(scene)),
                loss=self.loss(scene),
                groups=(Group("model", whole, self.rate),),
                validate=True,
            ),
        )


@dataclasses.dataclass(frozen=True)
class PaperSettings(LatentConfig):
    """What the text of "Which priors matter?" says otherwise than its code, for every model of the family."""

    rate: float = 5e-4
    """Learning rate of Adam."""
    kl_against: str = "frame"
    """Likelihood that the KL divergence is weighed against. `window`: the sum over all target frames, as in the
    released code. `frame`: the mean over the frames, as in eq. (3); the KL divergence then weighs as many times more as
    a window has target frames.
    """


@dataclasses.dataclass(frozen=True)
class FastSettings(LatentConfig):
    """Our recipe for every model of the family: pictures first, growing horizons, a small decoder, consistency."""

    beta: float = 0.1
    """Weight of the KL divergence in `elbo`."""
    taper: bool = True
    """Whether the decoder halves its channels each time it doubles the picture: a sixth of the work."""
    consistency: float = 0.001
    """Weight of the squared distance between a rolled-out state and the state that the encoder infers at the same
    frame, relative to the variance of such states. 0: no such term, as in the paper.
    """
    rendered: int = 8
    """Random target frames of each window that a step renders and compares; 0: all of them."""
    rate: float = 1.5e-3
    """Learning rate of Adam: constant while horizons grow, then annealed along half a cosine."""
    batch: int = 16
    """Windows a step."""
    steps: int = 2_500
    """Optimiser steps of all stages together."""
    pictures: float = 0.16
    """Share of the steps that the first stage takes, `pictures`, which predicts a single frame; 0: no such stage.
    Without it a decoder learns the mean picture where pictures are hard: longer motions are wrong at first.
    """
    pictures_rate: float = 5e-3
    """Learning rate of Muon in the stage `pictures`, for encoder and decoder; all other parameters have `rate`."""
    horizons: tuple[int, ...] = (8, 24)
    """Frames that the next stages predict; the last stage predicts all targets."""
    shares: tuple[float, ...] = (0.08, 0.12)
    """Shares of the steps that these stages take; the last stage takes the rest."""
    warmup: float = 0.03
    """Share of the steps of each stage in which the rate rises from zero: each begins with a fresh Adam."""
    final: float = 0.02
    """Last rate of the last stage, as a share of `rate`."""
    clip: float = 1.0
    """Largest norm of a gradient; larger ones are scaled down to it."""

    # In the stage `pictures`. Without it training cannot leave a picture whose values are all 0 or 1, which the first
    # steps may render.
    CROSS_ENTROPY: ClassVar[float] = 0.1
    SKIPS: ClassVar[int] = 20  # Along 60 frames gradients of some windows overflow, in LGN and RGN most of all.

    def __post_init__(self) -> None:
        """Refuse stages that do not fit together."""
        super().__post_init__()
        if len(self.horizons) != len(self.shares):
            raise KeycldError(
                "settings horizons and shares have one number for each of the first stages, not "
                f"{len(self.horizons)} and {len(self.shares)}: set both."
            )
        total = self.pictures + sum(self.shares)
        if total >= 1:
            raise KeycldError(f"the sum of settings pictures and shares is below 1, not {total:g}.")

    def migrated(self, settings: Mapping[str, Any], version: int) -> Mapping[str, Any]:
        """Return settings of schema 7 and earlier, in which no stage was for pictures alone."""
        settings = super().migrated(settings, version)
        return settings if version > 7 else {**settings, "pictures": 0.0}

    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return a stage for pictures, one for each horizon, and a validation score at the end."""
        from functools import partial

        from keycld.data import Windows
        from keycld.stages import Group, Stage, muon, warmup_cosine, whole

        def stage(
            name: str, steps: int, targets: int, *more: Group, cross_entropy: float | None = None, last: bool = False
        ) -> Stage:
            return Stage(
                name=name,
                steps=steps,
                sampler=Windows(self.batch, self.window(scene, targets)),
                loss=self.loss(scene, cross_entropy),
                groups=(Group("model", whole, self.rate), *more),
                schedule=partial(warmup_cosine, warmup=self.warmup, final=self.final if last else 1.0),
                clip=self.clip,
                skips=self.SKIPS,
                validate=last,
            )

        counts = [round(share * self.steps) for share in (self.pictures, *self.shares)]
        # Targets begin with the frame that the state belongs to.
        vision = Group("vision", _vision, self.pictures_rate, muon)
        first = [stage("pictures", counts[0], 2, vision, cross_entropy=self.CROSS_ENTROPY)]
        grown = [stage(f"horizon-{h}", count, h + 1) for h, count in zip(self.horizons, counts[1:], strict=True)]
        last = stage("horizon-all", self.steps - sum(counts), self.targets, last=True)
        return (*(first if counts[0] else []), *grown, last)


def _vision(model: Any) -> Any:
    """Select encoder and decoder."""
    return model.encoder, model.decoder
