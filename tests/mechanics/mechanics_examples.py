"""Mechanical systems whose motion is known, shared by the tests of the room."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld.mechanics import (
    ConstrainedLagrangian,
    Constraints,
    DistanceToPoint,
    FixedDistance,
    Motion,
    OnLine,
    PointMasses,
    State,
    ViscousFriction,
)

GOLDEN = Path(__file__).parent / "golden"
GRAVITY = 9.81


class Weight(eqx.Module):
    """The potential energy of point masses in gravity."""

    masses: jax.Array

    def __call__(self, x):
        return GRAVITY * jnp.sum(self.masses * x[1::2])


def law(masses, constraint, input_matrix=None, damping=None, potential=None):
    """`damping` is C of the viscous friction −C v."""
    masses = jnp.asarray(masses, float)
    friction = None if damping is None else ViscousFriction(jnp.asarray(damping, float))
    return ConstrainedLagrangian(
        PointMasses(jnp.sqrt(masses)), potential or Weight(masses), input_matrix, constraint, friction
    )


def pendulum(**options):
    return law([1.0], Constraints(("bob",), (DistanceToPoint("bob"),)), **options)


def double_pendulum(masses=(1.0, 0.7), **options):
    items = (DistanceToPoint("elbow"), FixedDistance("elbow", "tip"))
    return law(masses, Constraints(("elbow", "tip"), items), **options)


def cartpole(masses=(1.0, 0.5), **options):
    items = (OnLine("cart"), FixedDistance("cart", "tip"))
    return law(masses, Constraints(("cart", "tip"), items), **options)


def on_circle(angles, lengths=None):
    """Joints of a chain hung at the origin; angles from straight down, counter-clockwise."""
    angles = np.asarray(angles, float)
    lengths = np.ones_like(angles) if lengths is None else np.asarray(lengths)
    steps = lengths[:, None] * np.stack([np.sin(angles), -np.cos(angles)], axis=1)
    return jnp.asarray(np.cumsum(steps, axis=0).reshape(-1), float)


@eqx.filter_jit
def _initial_state(law, x, v):
    return State(Motion(x, law.project_velocity(x, v)), {"constants": law.constraint(x)})


def initial_state(law, x, v=None):
    """A state on the constraints, with the velocity made tangential."""
    x = jnp.asarray(x, float)
    return _initial_state(law, x, jnp.zeros_like(x) if v is None else jnp.asarray(v, float))


@eqx.filter_jit
def rollout(dynamics, state, u, dt, steps):
    """The dynamics' own roll-out, compiled."""
    return dynamics.rollout(state, u, dt, steps)


@eqx.filter_jit
def _end(dynamics, state, u, dt, steps):
    return jax.lax.fori_loop(0, steps, lambda _, s: dynamics.step(s, u, dt), state)


def end(dynamics, state, u, dt, steps):
    """The state after `steps` frames; compiled once for any number of them and any dt."""
    return _end(dynamics, state, u, jnp.asarray(dt, float), jnp.asarray(steps))


def last(motion):
    """The last of stacked motions."""
    return Motion(motion.x[-1], motion.v[-1])
