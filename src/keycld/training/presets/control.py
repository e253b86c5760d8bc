"""The default recipe for models that plan."""

import dataclasses
import functools

from keycld.training.presets.base import Scene
from keycld.training.presets.fast import FastRecipe
from keycld.training.presets.prepare import (
    cache_keypoints,
    fit_dynamics,
    in_turn,
    measure_beginning,
    share_constants,
)
from keycld.training.stages import Stage


@dataclasses.dataclass(frozen=True)
class ControlRecipe(FastRecipe):
    """`fast` with a longer last stage and, after it, one more least-squares fit of the dynamics.

    Prediction hardly asks for exact forces, planning does: with the fit the acrobot's elbow torque is .96 of MuJoCo's
    instead of .92, and a motion that is planned with one motor for two links arrives.

    - `last_fit`: trajectories of that fit.
    """

    long_steps: int = 10800
    last_fit: int = 225

    def __post_init__(self) -> None:
        """A fit needs a trajectory."""
        super().__post_init__()
        self._check_counts("last_fit")

    def stages(self, scene: Scene, kind: str = "keycld") -> tuple[Stage, ...]:
        """Those of `fast`, and one without steps that fits."""
        stages = super().stages(scene, kind)
        last = functools.partial(fit_dynamics, trajectories=self.last_fit)
        prepare = in_turn(cache_keypoints, share_constants, last, measure_beginning)
        return *stages, dataclasses.replace(stages[-1], name="fit", prepare=prepare)
