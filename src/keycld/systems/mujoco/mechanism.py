"""What all mechanisms in MuJoCo share: their inputs, their recordings, and the camera that watches them."""

import abc
import math
from typing import ClassVar

import numpy as np

from keycld.systems.base import AbstractMechanism, Conditions, Run

# Half of MuJoCo's default vertical field of view, 45 degrees.
_HALF_VIEW = math.radians(22.5)
_ZERO_INPUT_PROBABILITY = 0.2
# Step of the random walk as a part of the limit: it crosses its range in about 50 frames.
_WALK = 0.15


class AbstractWatchedMechanism(AbstractMechanism):
    """A mechanism in the plane y = 0, seen by a camera that looks along +y with z up.

    Attributes:
        camera_offset: x of the fixed camera, metres.
        camera_height: of the fixed camera, metres.
        camera_distance: of the fixed camera from the plane of motion, metres.
    """

    input_range: ClassVar[float] = 3.0
    camera_offset: ClassVar[float] = 0.0
    camera_height: ClassVar[float]
    camera_distance: ClassVar[float]

    @abc.abstractmethod
    def initial_values(self, random: np.random.RandomState, conditions: Conditions) -> tuple[np.ndarray, np.ndarray]:
        """Sample initial positions and velocities."""

    @abc.abstractmethod
    def simulate(self, state: np.ndarray, u: np.ndarray, frames: int, *, clip: bool = True) -> Run:
        """Simulate the motion from `state [d]` under `u`, `[l]` constant or `[frames, l]` held from frame to frame.

        The first frame is the state one frame **after** `state`.
        """

    @abc.abstractmethod
    def energies(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return kinetic and potential energy `[T]`, joules, of states `[T, d]`; height is zero at z = 0."""

    @property
    def control_modes(self) -> tuple[str, ...]:
        """All modes; `"under"` and the names of single motors exist where there are two."""
        return ("none", "full") if len(self.input_names) < 2 else ("none", "under", "full", *self.input_names)

    def to_image_plane(self, points: np.ndarray) -> np.ndarray:
        """Return the image-plane coordinates of world points `[..., 2]` = (x, z) in the plane y = 0, metres."""
        half_height = self.camera_distance * math.tan(_HALF_VIEW)
        # The edges of the picture are at ±1 of the view, the centres of its outermost pixels half a pixel
        # inside.
        scale = self.size / (self.size - 1) / half_height
        return (points - np.array([self.camera_offset, self.camera_height])) * scale

    def _input(self, random: np.random.RandomState, conditions: Conditions) -> np.ndarray:
        limit = conditions.input_limit
        u = random.uniform(-limit, limit, size=len(self.input_names))
        chosen = {"none": (), "under": self.input_names[:1], "full": self.input_names}
        acting = chosen.get(conditions.control, (conditions.control,))
        idle = (acting or conditions.idle_number) and random.uniform() < _ZERO_INPUT_PROBABILITY
        u[[idle or name not in acting for name in self.input_names]] = 0.0
        return u

    def record(self, random: np.random.RandomState, frames: int, conditions: Conditions) -> Run:
        """Simulate one run from random numbers that are taken in a fixed order.

        The order: the input; one number that sets it to zero below 0.2 (not where no input acts and `idle_number` is
        False); the initial state; the steps of a random walk.
        """
        self.check(conditions)
        u = self._input(random, conditions)
        state = np.concatenate(self.initial_values(random, conditions))
        if conditions.input == "constant":
            return self.simulate(state, u, frames, clip=conditions.clip)
        # Frame 0 is seen after the first step, so the input from frame k to k + 1 is the one of step k + 2.
        walk = random_walk(random, u, frames + 1, conditions.input_limit)
        run = self.simulate(state, walk[:-1], frames, clip=conditions.clip)
        return run._replace(input=walk[1:])


def random_walk(random: np.random.RandomState, start: np.ndarray, steps: int, limit: float) -> np.ndarray:
    """Sample inputs `[steps, l]` that wander within ± `limit` from `start [l]`; those that are 0 at first stay 0."""
    walk = start + np.concatenate(
        [np.zeros((1, len(start))), np.cumsum(_WALK * limit * random.randn(steps - 1, len(start)), axis=0)]
    )
    # Reflected at the limits: a triangle wave of the free walk.
    folded = limit - np.abs((walk + limit) % max(4 * limit, 1e-12) - 2 * limit)
    return np.where(start == 0.0, 0.0, folded)
