"""The acrobot: two links of 1 kg and 1 m with motors in both joints."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.base import SweepPath
from keycld.systems.mujoco import sweeping
from keycld.systems.mujoco.base import AbstractMujocoSystem, uniform_angles, wrapped
from keycld.systems.registry import register

if TYPE_CHECKING:
    import keycld.mechanics

LENGTH = 1.0
SHOULDER_HEIGHT = 2.1


@register
class Acrobot(AbstractMujocoSystem):
    """A double pendulum of two uniform capsules; torques 2 u₁ at the shoulder and 2 u₂ at the elbow, N m.

    Lagrangian L = I (α̇² + β̇²) / 2 + m (|ċ₁|² + |ċ₂|²) / 2 − m g (z₁ + z₂) with absolute angles α = θ₁ and β = θ₁ + θ₂,
    centres c₁ = l/2 (sin α, cos α), c₂ = l (sin α, cos α) + l/2 (sin β, cos β), m = 1 kg, l = 1 m, and I the inertia of
    a capsule about its centre. State: shoulder θ₁ in rad (0 upright, positive to the right), elbow θ₂ relative to the
    upper arm, their velocities. Two keypoints: the elbow at a fixed distance from the shoulder, which is the image
    centre, and the tip at one from the elbow. Chaotic at high energy. Source: KeyCLD (arXiv 2206.11030), appendix A.6
    and Fig. 7.
    """

    name = "acrobot"
    dt = 0.01
    state_names = ("shoulder", "elbow", "shoulder_velocity", "elbow_velocity")
    units = ("rad", "rad", "rad/s", "rad/s")
    input_names = ("shoulder_torque", "elbow_torque")
    keypoints = ("elbow", "tip")
    camera_height = 2.1
    camera_distance = 6.0

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """|x₁| and |x₁ − x₂| are constant."""
        from keycld.mechanics import Constraints, DistanceToPoint, FixedDistance

        return Constraints(
            keypoints=self.keypoints,
            items=(DistanceToPoint("elbow", (0.0, 0.0)), FixedDistance("elbow", "tip")),
        )

    def landmarks(self, state: np.ndarray) -> np.ndarray:
        """Return the elbow's axis and the end of the lower arm's axis `[..., 2, 2]`."""
        shoulder, lower = state[..., 0], state[..., 0] + state[..., 1]
        elbow = LENGTH * np.stack([np.sin(shoulder), np.cos(shoulder)], axis=-1) + np.array([0.0, SHOULDER_HEIGHT])
        tip = elbow + LENGTH * np.stack([np.sin(lower), np.cos(lower)], axis=-1)
        return self.to_image_plane(np.stack([elbow, tip], axis=-2))

    def tilts(self, state: np.ndarray) -> np.ndarray:
        """Return the angle of the upper arm, and of the lower arm, which is the sum of both joints'."""
        return wrapped(np.stack([state[..., 0], state[..., 0] + state[..., 1]], axis=-1))

    def rest(self, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        """Sample any two angles; the velocities are zero."""
        return uniform_angles(random, 2), np.zeros(2)

    def positions(self, random: np.random.RandomState, slider_limit: float) -> np.ndarray:
        """Sample any two angles."""
        return uniform_angles(random, 2)

    def sweeps(self) -> tuple[SweepPath, ...]:
        """Return a turn of the stretched arm (Fig. 11), one of the elbow with a hanging upper arm (Fig. 12), a grid."""
        return (
            sweeping.path(self.state_names, "shoulder", {"shoulder": sweeping.FULL_TURN}, {"elbow": 0.0}),
            sweeping.path(self.state_names, "elbow", {"elbow": sweeping.FULL_TURN}, {"shoulder": np.pi}),
            sweeping.grid(self.state_names, "grid", {"shoulder": sweeping.FULL_TURN, "elbow": sweeping.FULL_TURN}),
        )
