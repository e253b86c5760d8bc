"""The cartpole: a cart of 1 kg on an endless rail with a pole of 0.1 kg and 1 m."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.systems.base import SweepPath
from keycld.systems.mujoco import sweeping
from keycld.systems.mujoco.base import AbstractMujocoSystem, wrapped
from keycld.systems.registry import register

if TYPE_CHECKING:
    import keycld.mechanics

LENGTH = 1.0
CART_HEIGHT = 1.0
# Parts of the rail, in metres, on which the cart stays in the picture, and the pole at any angle too.
CART_SWEEP = (-2.0, 2.0)
GRID_SWEEP = (-1.3, 1.3)


@register
class Cartpole(AbstractMujocoSystem):
    """A cart pushed by 4 u₁ newtons and a pole (uniform, from the cart's centre) turned by u₂ newton metres.

    Lagrangian L = (M + m) ṡ² / 2 + m (l/2) ṡ θ̇ cos θ + m l² θ̇² / 6 − m g (l/2) cos θ with M = 1 kg, m = 0.1 kg, l = 1 m
    (a thin pole; MuJoCo uses the inertia of its capsule). State: slider s in m (positive to the right), hinge θ in rad
    (0 upright, positive to the right), their velocities. Two keypoints: the cart on a horizontal line, the tip of the
    pole at a fixed distance from it. Source: KeyCLD (arXiv 2206.11030), appendix A.6 and Fig. 7.
    """

    name = "cartpole"
    dt = 0.01
    state_names = ("position", "angle", "velocity", "angular_velocity")
    units = ("m", "rad", "m/s", "rad/s")
    input_names = ("force", "torque")
    keypoints = ("cart", "tip")
    camera_height = 1.0
    camera_distance = 6.0

    @property
    def constraints(self) -> "keycld.mechanics.Constraints":
        """y₁ and |x₁ − x₂| are constant."""
        from keycld.mechanics import Constraints, FixedDistance, OnLine

        return Constraints(
            keypoints=self.keypoints,
            items=(OnLine("cart", direction=(1.0, 0.0)), FixedDistance("cart", "tip")),
        )

    def landmarks(self, state: np.ndarray) -> np.ndarray:
        """Return the centre of the cart, where the hinge is, and the end of the pole's axis `[..., 2, 2]`."""
        slider, angle = state[..., 0], state[..., 1]
        cart = np.stack([slider, np.full_like(slider, CART_HEIGHT)], axis=-1)
        tip = cart + LENGTH * np.stack([np.sin(angle), np.cos(angle)], axis=-1)
        return self.to_image_plane(np.stack([cart, tip], axis=-2))

    def tilts(self, state: np.ndarray) -> np.ndarray:
        """Return the angle of the pole."""
        return wrapped(state[..., 1:2])

    def rest(self, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        """Sample the hanging state with a little noise."""
        position = np.array([0.01 * random.randn(), np.pi + 0.01 * random.randn()])
        return position, 0.01 * random.randn(2)

    def positions(self, random: np.random.RandomState, slider_limit: float) -> np.ndarray:
        """Sample the slider within its limit, and any angle."""
        return np.array([random.uniform(-slider_limit, slider_limit), random.uniform(-np.pi, np.pi)])

    def sweeps(self) -> tuple[SweepPath, ...]:
        """Return a turn of the pole on a still cart (Fig. 9), a move of the cart (Fig. 10), and the grid of both."""
        turn = {"angle": sweeping.FULL_TURN}
        return (
            sweeping.path(self.state_names, "pole", turn, {"position": 0.0}),
            sweeping.path(self.state_names, "cart", {"position": CART_SWEEP}, {"angle": np.pi}),
            sweeping.grid(self.state_names, "grid", {"position": GRID_SWEEP} | turn),
        )
