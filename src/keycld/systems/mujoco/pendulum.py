"""The pendulum: a bob of 1 kg on a massless rod of 0.5 m, driven by a motor in its pivot."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.base import SweepPath
from keycld.systems.mujoco import sweeping
from keycld.systems.mujoco.base import AbstractMujocoSystem, uniform_angles, wrapped
from keycld.systems.registry import register

if TYPE_CHECKING:
    import keycld.mechanics

LENGTH = 0.5


@register
class Pendulum(AbstractMujocoSystem):
    """m l² θ̈ = m g l sin θ + 2 u, with m = 1 kg, l = 0.5 m, g = 9.81 m/s² and θ = 0 upright (positive to the right).

    Lagrangian L = m l² θ̇² / 2 − m g l cos θ; MuJoCo adds the bob's own inertia 2/5 m r², r = 0.05 m. State: θ in rad,
    θ̇ in rad/s; input: u in N m before the gear of 2. The hardest of the paper's three systems: the thinnest pole and
    speeds up to 27.6 rad/s. One keypoint, the bob, at a fixed distance from the pivot, which is the image centre.
    Source: KeyCLD (arXiv 2206.11030), appendix A.6 and Fig. 7.
    """

    name = "pendulum"
    dt = 0.02
    state_names = ("angle", "angular_velocity")
    units = ("rad", "rad/s")
    input_names = ("torque",)
    keypoints = ("tip",)
    camera_height = 0.6
    camera_distance = 2.5

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """|x₁| is constant."""
        from keycld.mechanics import Constraints, DistanceToPoint

        return Constraints(keypoints=self.keypoints, items=(DistanceToPoint("tip", (0.0, 0.0)),))

    def landmarks(self, state: np.ndarray) -> np.ndarray:
        """Return the centre of the bob `[..., 1, 2]`."""
        angle = state[..., 0]
        tip = np.stack([LENGTH * np.sin(angle), self.camera_height + LENGTH * np.cos(angle)], axis=-1)
        return self.to_image_plane(tip[..., None, :])

    def tilts(self, state: np.ndarray) -> np.ndarray:
        """Return the angle of the rod."""
        return wrapped(state[..., :1])

    def rest(self, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        """Sample any angle; the velocity is zero."""
        return uniform_angles(random, 1), np.zeros(1)

    def positions(self, random: np.random.RandomState, slider_limit: float) -> np.ndarray:
        """Sample any angle."""
        return uniform_angles(random, 1)

    def sweeps(self) -> tuple[SweepPath, ...]:
        """Return a full turn (Fig. 8) and 16 angles."""
        return (
            sweeping.path(self.state_names, "rotation", {"angle": sweeping.FULL_TURN}, {}),
            sweeping.grid(self.state_names, "grid", {"angle": sweeping.FULL_TURN}),
        )
