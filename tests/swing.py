"""A model of the disc pendulum in `scenes` that needs no training: it sees centroids and knows the law of motion."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld.mechanics import (
    ConstrainedLagrangian,
    Constraints,
    DistanceToPoint,
    MechanicalDynamics,
    Motion,
    PointMasses,
    Rattle,
    State,
    joining_velocity,
)
from keycld.models.base import AbstractModel, HasKeypoints, HasLagrangian, Reversible
from keycld.systems import AbstractSystem
from keycld.vision import Observation, image_grid
from scenes import DT, SIZE

RADIUS = 0.6


def without_pictures(trajectories):
    """The same as a file that a renderer is to draw."""
    attributes = {**trajectories.attributes, "renderer": "none", "renderer_version": "0"}
    return dataclasses.replace(trajectories, image=None, attributes=attributes)


class Weight(eqx.Module):
    """V = m g y."""

    gravity: jax.Array

    def __call__(self, x):
        return self.gravity * x[1]


class Torque(eqx.Module):
    """The force along the circle that turns the disc by 6 u rad/s²."""

    def __call__(self, x):
        return (6.0 * jnp.stack([-x[1], x[0]]))[:, None]


class Swing(AbstractModel, Reversible, HasKeypoints, HasLagrangian):
    """Centroid → constrained Lagrangian → soft disc. With gravity 5.4 it is right; any other value is wrong."""

    dynamics: MechanicalDynamics

    context: ClassVar[int] = 2
    constants: ClassVar[None] = None

    @property
    def law(self):
        return self.dynamics.law

    @classmethod
    def right(cls, gravity: float = 9.0 * RADIUS) -> "Swing":
        constraints = Constraints(("disc",), (DistanceToPoint("disc", (0.0, 0.0)),))
        law = ConstrainedLagrangian(PointMasses.ones(1), Weight(jnp.array(gravity)), Torque(), constraints)
        return cls(MechanicalDynamics(law, Rattle(substeps=2)))

    def anchor(self, n):
        return 1

    def observe(self, frame):
        weight = jnp.maximum(frame[..., 0] - 0.12, 0.0)
        weight = weight / jnp.sum(weight)
        keypoint = jnp.einsum("hw,hwd->d", weight, image_grid(SIZE, SIZE))
        return Observation(keypoint[None], weight[None])

    def keypoints(self, state):
        return state.coordinates.x.reshape(1, 2)

    def at_rest(self, keypoints):
        x = keypoints.reshape(-1)
        return State(Motion(x, jnp.zeros_like(x)), {"constants": self.law.constraint(x)})

    def infer(self, frames, dt, u):
        law = self.dynamics.law
        x0, x1 = (self.observe(frame).keypoints[0] for frame in frames[:2])
        constants = (law.constraint(x0) + law.constraint(x1)) / 2
        x0, x1 = law.project_position(x0, constants), law.project_position(x1, constants)
        first = u if u.ndim == 1 else u[0]
        parameters = {"constants": constants}
        v0 = joining_velocity(self.dynamics, x0, x1, parameters, first, dt)
        return self.dynamics.step(State(Motion(x0, v0), parameters), first, dt)

    def rollout(self, state, dt, u, steps):
        motion = self.dynamics.rollout(state, u, dt, steps)
        parameters = jax.tree.map(lambda p: jnp.broadcast_to(p, (steps + 1, *p.shape)), state.parameters)
        return State(motion, parameters)

    def render(self, state):
        gap = image_grid(SIZE, SIZE) - state.coordinates.x[None, None, :]
        shape = jax.nn.sigmoid(-12.0 * (jnp.sqrt(jnp.sum(gap**2, axis=-1) + 1e-12) - 0.25))
        return 0.1 + 0.8 * shape[..., None] * jnp.array([0.9, 0.6, 0.2])[None, None, :]


class Still(AbstractModel):
    """No keypoints, no energies, no motion: shows the first given frame for ever."""

    context: ClassVar[int] = 1

    def anchor(self, n):
        return 0

    def infer(self, frames, dt, u):
        return State(frames[0], {})

    def rollout(self, state, dt, u, steps):
        return State(jnp.broadcast_to(state.coordinates, (steps + 1, *state.coordinates.shape)), {})

    def render(self, state):
        return state.coordinates


class DiscSystem(AbstractSystem):
    """What the probe asks of a system, for `scenes.disc_pendulum`."""

    name = "disc"
    dt = DT
    size = SIZE
    state_names = ("angle", "rate")
    units = ("rad", "rad/s")
    input_names = ("torque",)
    input_range = 1.0
    keypoints = ("disc",)
    control_modes = ("full",)
    initial_states = ("rest",)

    @property
    def constraints(self):
        return Constraints(("disc",), (DistanceToPoint("disc", (0.0, 0.0)),))

    def landmarks(self, state):
        angle = state[..., 0]
        return RADIUS * np.stack([np.sin(angle), -np.cos(angle)], axis=-1)[..., None, :]

    def record(self, random, frames, conditions):
        raise NotImplementedError

    def sweeps(self):
        return ()

    def drawer(self):
        raise NotImplementedError
