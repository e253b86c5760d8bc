"""The preset for models that plan."""

import dataclasses
import functools
from typing import TYPE_CHECKING

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
    """The preset `fast` with a longer fourth stage and, at the end, one more least-squares fit of the dynamics.

    Planning needs more exact forces than prediction does. With the fit the learned elbow torque of the acrobot is .96
    of MuJoCo's instead of .92, and motions planned with one motor for two links reach their goal.
    """

    long: JointStage = JointStage(steps=10800, horizons=(32, 50))
    """Fourth stage."""
    last_fit: int = 225
    """Trajectories of the last least-squares fit."""

    def __post_init__(self) -> None:
        """Refuse a fit without a trajectory."""
        super().__post_init__()
        at_least_one(self, "last_fit")

    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return the stages of `fast`, and one without steps that fits the dynamics."""
        from keycld.models.keycld import prepare

        stages = super().stages(scene)
        last = functools.partial(prepare.fit_dynamics, trajectories=self.last_fit)
        steps = (prepare.cache_keypoints, prepare.share_constants, last, prepare.measure_velocity_prior)
        return *stages, dataclasses.replace(stages[-1], name="fit", prepare=prepare.sequence(*steps))
