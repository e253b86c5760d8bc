"""A model of the MuJoCo pendulum that needs no training: it finds the orange rod and has the true physics."""

import jax.numpy as jnp
import numpy as np
from true_physics import truth

from keycld.control import Plant
from keycld.mechanics import MechanicalDynamics, Motion, State
from keycld.models.base import AbstractModel, HasKeypoints, HasLagrangian
from keycld.systems import get
from keycld.vision import Observation, image_grid

LENGTH = 0.49


def picture(angle=0.0):
    """The camera's picture of the pendulum at an angle."""
    with Plant(get("pendulum"), np.array([[angle, 0.0]]), workers=1) as plant:
        return plant.look()[0]


class PendulumModel(AbstractModel, HasKeypoints, HasLagrangian):
    """Its keypoint is the direction of what is orange, at the length of the rod; it renders only the background."""

    dynamics: MechanicalDynamics
    background: np.ndarray

    context = 2

    @classmethod
    def make(cls):
        two = np.stack([picture(0.0), picture(np.pi)])
        # Where the rod is in neither of the two, both show the background.
        background = np.where((two[0, ..., 0] > two[0, ..., 2])[..., None], two[1], two[0]) / 255.0
        return cls(truth("pendulum").dynamics, background)

    @property
    def law(self):
        return self.dynamics.law

    @property
    def constants(self):
        return None

    def anchor(self, n):
        return 1

    def observe(self, frame):
        weight = jnp.maximum(frame[..., 0] - frame[..., 2] - 0.05, 0.0)
        mean = jnp.einsum("hw,hwd->d", weight, image_grid(64, 64))
        return Observation((LENGTH * mean / (jnp.linalg.norm(mean) + 1e-9))[None], None)

    def keypoints(self, state):
        return state.coordinates.x.reshape(1, 2)

    def at_rest(self, keypoints):
        x = keypoints.reshape(-1)
        return State(Motion(x, 0 * x), {"constants": self.law.constraint(x)})

    def render(self, state):
        return jnp.asarray(self.background, jnp.float32)

    def infer(self, frames, dt, u):
        raise NotImplementedError

    def rollout(self, state: State, dt, u, steps):
        raise NotImplementedError
