"""The preset for models that plan."""

import dataclasses
from typing import TYPE_CHECKING, ClassVar

from keycld.models.config import at_least_one
from keycld.models.keycld.config import MODELS
from keycld.models.keycld.recipes.fast import FastConfig, JointStage
from keycld.models.registry import register_preset
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from keycld.stages import Stage


@register_preset("control", *MODELS)
@dataclasses.dataclass(frozen=True)
class ControlConfig(FastConfig):
    """The preset `fast` with a longer third stage, whose last least-squares fit observes more recordings.

    Planning needs more exact forces than prediction does.
    """

    OWN: ClassVar[bool] = False

    joint: JointStage = JointStage(steps=6000, fit_every=1000)
    """Third stage."""
    last_fit: int = 225
    """Trajectories of the last least-squares fit."""

    def __post_init__(self) -> None:
        """Refuse a fit without a trajectory."""
        super().__post_init__()
        at_least_one(self, "last_fit")

    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return the stages of `fast` with the last fit of the preset."""
        from keycld.models.keycld import fast_stages

        return fast_stages.stages(self, scene, self.last_fit)
