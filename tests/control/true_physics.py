"""The three systems as constrained point masses with MuJoCo's own masses and inertias, in image-plane units.

A rigid body is two point masses (appendix A.3). What hangs on a fixed pivot needs only one of them.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld.mechanics import (
    ConstrainedLagrangian,
    MechanicalDynamics,
    Motion,
    PointMasses,
    Rattle,
    RigidBody,
    State,
    two_point_masses,
)
from keycld.systems import get
from keycld.systems.mujoco.loading import load_model

GRAVITY = 9.81


class Truth(NamedTuple):
    """A law of motion that MuJoCo obeys too, and the way from MuJoCo's states to its keypoints."""

    system: object
    law: ConstrainedLagrangian
    position: Callable

    @property
    def dynamics(self):
        return MechanicalDynamics(self.law, Rattle(substeps=4))

    def motion(self, state):
        """Positions and velocities [2K] of a state [d]."""
        q, rate = jnp.split(jnp.asarray(state, float), 2)
        x, v = jax.jvp(self.position, (q,), (rate,))
        return State(Motion(x, v), {"constants": self.law.constraint(x)})

    @property
    def upright(self):
        return self.position(jnp.zeros(len(self.system.state_names) // 2))


class Weight(eqx.Module):
    """V = Σ weightₖ yₖ."""

    weights: jax.Array

    def __call__(self, x):
        return jnp.sum(self.weights * x[1::2])


class Pushes(eqx.Module):
    """Inputs: `slides` push keypoint 0 along x; each couple turns an arm (first, second keypoint; −1: the pivot)."""

    slides: tuple = eqx.field(static=True)
    couples: tuple = eqx.field(static=True)
    scale: float = eqx.field(static=True)

    def __call__(self, x):
        points = [x[2 * k : 2 * k + 2] for k in range(x.shape[0] // 2)]
        none = jnp.zeros_like(x)
        columns = [none.at[0].set(force * self.scale) for force in self.slides]
        for turns in self.couples:
            column = none
            for torque, first, second in turns:
                arm = points[second] - (points[first] if first >= 0 else 0.0)
                couple = torque * self.scale**2 * jnp.stack([arm[1], -arm[0]]) / jnp.sum(arm * arm)
                column = column.at[2 * second : 2 * second + 2].add(couple)
                if first >= 0:
                    column = column.at[2 * first : 2 * first + 2].add(-couple)
            columns.append(column)
        return jnp.stack(columns, axis=1)


def _law(masses, weights, pushes, constraints, scale):
    masses = jnp.asarray(masses, float)
    potential = Weight(GRAVITY * scale * jnp.asarray(weights, float))
    return ConstrainedLagrangian(PointMasses(jnp.sqrt(masses)), potential, pushes, constraints)


def _body(model, name):
    body = model.body(name)
    return RigidBody(float(body.mass[0]), float(body.inertia[1]), np.array([0.0, float(body.ipos[2])]))


def _direction(angle):
    return jnp.stack([jnp.sin(angle), jnp.cos(angle)])


def truth(name):
    """The true physics of a system."""
    system = get(name)
    model = load_model(get(name).model_file)
    scale = float(np.linalg.norm(system.to_image_plane(np.array([1.0, system.camera_height]))))
    if name == "pendulum":
        pole = _body(model, "pole")
        length = float(pole.centre[1])
        moment = (pole.inertia + pole.mass * length**2) / length**2
        length *= scale
        law = _law([moment], [pole.mass], Pushes((), (((2.0, -1, 0),),), scale), system.constraints, scale)
        return Truth(system, law, lambda q: length * _direction(q[0]))
    if name == "cartpole":
        pair = two_point_masses(_body(model, "pole"), np.zeros(2))
        masses = np.array([1.0 + pair.masses[0], pair.masses[1]])
        length = float(np.linalg.norm(pair.points[1])) * scale
        law = _law(masses, masses, Pushes((4.0,), (((1.0, 0, 1),),), scale), system.constraints, scale)

        def cartpole(q):
            cart = jnp.stack([q[0] * scale, 0 * q[0]])
            return jnp.concatenate([cart, cart + length * _direction(q[1])])

        return Truth(system, law, cartpole)
    upper, lower = _body(model, "upper_arm"), _body(model, "lower_arm")
    moment = upper.inertia + upper.mass * upper.centre[1] ** 2
    pair = two_point_masses(lower, np.zeros(2))
    length = float(np.linalg.norm(pair.points[1])) * scale
    law = _law(
        [moment + pair.masses[0], pair.masses[1]],
        [upper.mass * upper.centre[1] + pair.masses[0], pair.masses[1]],
        Pushes((), (((2.0, -1, 0),), ((2.0, 0, 1), (-2.0, -1, 0))), scale),
        system.constraints,
        scale,
    )

    def acrobot(q):
        elbow = scale * _direction(q[0])
        return jnp.concatenate([elbow, elbow + length * _direction(q[0] + q[1])])

    return Truth(system, law, acrobot)
