"""A first guess of a law from observed paths."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import double_pendulum, on_circle

from keycld.mechanics import (
    ConstrainedLagrangian,
    Constraints,
    CoupledMasses,
    MechanicalDynamics,
    Motion,
    PointMasses,
    Rattle,
    State,
    SumPotential,
    regress_forces,
    with_kinds,
)

DT = 1 / 60


@pytest.fixture(scope="module")
def paths():
    """Forty motions of a double pendulum with friction, observed with an error of a tenth of a pixel of 64."""
    true = double_pendulum(masses=(1.0, 0.5), damping=[[0.6, 0.0], [0.0, 0.2]])
    rng = np.random.default_rng(0)

    def state(angles, rates):
        x, v = jax.jvp(lambda q: chain(q), (angles,), (rates,))
        return State(Motion(x, v), {"constants": jnp.ones(2)})

    states = jax.vmap(state)(*(jnp.asarray(rng.uniform(-2, 2, (40, 2)), jnp.float32) for _ in range(2)))
    dynamics = MechanicalDynamics(true, Rattle(4))
    x = jax.jit(jax.vmap(lambda s: dynamics.rollout(s, jnp.zeros(0), DT, 49).x))(states)
    return true, x + 0.003 * jax.random.normal(jax.random.key(0), x.shape)


def chain(q):
    first = jnp.stack([jnp.sin(q[0]), -jnp.cos(q[0])])
    return jnp.concatenate([first, first + jnp.stack([jnp.sin(q[1]), -jnp.cos(q[1])])])


def test_masses_gravity_and_friction_of_a_double_pendulum(paths):
    true, seen = paths
    blank = (CoupledMasses.ones(2), SumPotential(jnp.zeros(4), {}))
    guess = eqx.tree_at(lambda it: (it.mass, it.potential), true, blank)
    guess = with_kinds(
        eqx.tree_at(lambda it: it.dissipation, guess, None), ("springs", "viscous"), key=jax.random.key(0)
    )
    found = regress_forces(guess, jax.tree.map(eqx.is_inexact_array, guess), seen, jnp.zeros((40, 0)), DT)
    x, v, u = on_circle([0.7, -0.4]), jnp.array([0.4, 0.3, 0.0, 0.5]), jnp.zeros(0)
    v = true.project_velocity(x, v)
    expected = true.acceleration(x, v, u)
    np.testing.assert_allclose(found.acceleration(x, v, u), expected, atol=0.15 * float(jnp.abs(expected).max()))
    assert float(found.mass.matrix[1, 1] / found.mass.matrix[0, 0]) == pytest.approx(0.5, abs=0.25)


def test_free_keypoints_have_no_constraints_to_leave_out(paths):
    """`Constraints` without an item, as for two bodies: their springs are found."""
    law = ConstrainedLagrangian(PointMasses.ones(2), SumPotential(jnp.zeros(4), {}), None, Constraints(("a", "b")))
    guess = with_kinds(law, ("springs",), key=jax.random.key(0))
    time = DT * jnp.arange(50)[None, :, None]
    phase = jax.random.uniform(jax.random.key(1), (20, 1, 4), minval=-3.0, maxval=3.0)
    seen = jnp.sin(2.0 * time + phase)
    found = regress_forces(guess, jax.tree.map(eqx.is_inexact_array, guess), seen, jnp.zeros((20, 0)), DT)
    x = jnp.array([0.3, -0.2, 0.5, 0.1])
    np.testing.assert_allclose(found.acceleration(x, jnp.zeros(4), jnp.zeros(0)), -4.0 * x, atol=0.1)
