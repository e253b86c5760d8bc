"""The constrained law of motion, eq. (6), and its energies."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mechanics_examples import GRAVITY, cartpole, double_pendulum, initial_state, law, on_circle, pendulum

from keycld import KeycldError
from keycld.mechanics import ConstrainedLagrangian, Constraints, DistanceToPoint, FixedDistance, PointMasses


class Uniform(eqx.Module):
    """An input matrix that is the same everywhere."""

    matrix: jax.Array

    def __call__(self, x):
        return self.matrix


@eqx.filter_jit
def accelerate(law, x, v, u):
    return law.acceleration(x, v, u)


def test_pendulum_accelerates_as_the_textbook_says():
    angle, speed = 0.8, 1.7
    x, v = on_circle([angle]), speed * jnp.array([np.cos(angle), np.sin(angle)])
    tangential, radial = -GRAVITY * np.sin(angle), speed**2
    expected = tangential * np.array([np.cos(angle), np.sin(angle)]) - radial * np.asarray(x)
    np.testing.assert_allclose(accelerate(pendulum(), x, v, jnp.zeros(0)), expected, rtol=1e-5)


def test_free_masses_fall():
    free = law([1.0, 3.0], None)
    a = accelerate(free, jnp.arange(4.0), jnp.ones(4), jnp.zeros(0))
    np.testing.assert_allclose(a, [0, -GRAVITY, 0, -GRAVITY], rtol=1e-6)
    assert free.count == 0


def test_atwood_machine_by_a_function():
    """Two masses on one rope over a pulley: a = g (m₁ − m₂)/(m₁ + m₂); rails as further constraints."""

    def rope(x, parameters):
        return jnp.stack([x[1] + x[3], x[0], x[2]])

    machine = law([3.0, 1.0], rope)
    a = accelerate(machine, jnp.array([0.0, -1.0, 1.0, -2.0]), jnp.zeros(4), jnp.zeros(0))
    np.testing.assert_allclose(a, [0, -GRAVITY / 2, 0, GRAVITY / 2], atol=1e-5)


def test_acceleration_keeps_the_constraint_to_second_order():
    acrobot = double_pendulum()
    state = initial_state(acrobot, on_circle([0.4, 2.0]), jnp.array([1.0, -2.0, 0.5, 3.0]))
    x, v = state.coordinates
    a = accelerate(acrobot, x, v, jnp.zeros(0))

    def along(t):
        return acrobot.constraint(x + t * v + t * t / 2 * a)

    first = jax.jacfwd(along)
    np.testing.assert_allclose(first(0.0), np.zeros(2), atol=1e-5)
    np.testing.assert_allclose(jax.jacfwd(first)(0.0), np.zeros(2), atol=1e-4)


def test_constants_do_not_matter():
    """Only DΦ enters eq. (6): adding numbers to Φ changes nothing."""
    acrobot = double_pendulum()
    shifted = double_pendulum()
    shifted = eqx.tree_at(
        lambda law: law.constraint_function,
        shifted,
        Constraints(("elbow", "tip"), (lambda x, p: acrobot.constraint(x) + 7.0,)),
    )
    x, v = initial_state(acrobot, on_circle([1.0, 2.0]), jnp.ones(4)).coordinates
    u = jnp.zeros(0)
    np.testing.assert_allclose(accelerate(acrobot, x, v, u), accelerate(shifted, x, v, u), rtol=1e-5)


@settings(max_examples=15, deadline=None)
@given(factor=st.sampled_from([0.01, 0.3, 7.0, 500.0]), seed=st.integers(0, 100))
def test_a_common_factor_of_mass_potential_input_and_damping_changes_nothing(factor, seed):
    rng = np.random.default_rng(seed)
    x, v, u = (jnp.asarray(rng.normal(size=n), jnp.float32) for n in (4, 4, 2))
    g = jnp.asarray(rng.normal(size=(4, 2)), jnp.float32)
    low = jnp.asarray(rng.normal(size=(2, 2)), jnp.float32)

    def scaled(c):
        return cartpole(
            masses=(c * 1.0, c * 0.5),
            input_matrix=Uniform(c * g),
            damping=c * low @ low.T,
        )

    one, other = scaled(1.0), scaled(factor)
    np.testing.assert_allclose(
        accelerate(one, x, v, u), accelerate(other, x, v, u), rtol=1e-3, atol=1e-3 * float(jnp.abs(v).max())
    )
    np.testing.assert_allclose(factor * one.energy(x, v), other.energy(x, v), rtol=1e-4)


def test_projected_velocity_is_tangential_and_the_nearest():
    acrobot = double_pendulum(masses=(1.0, 5.0))
    x, v = on_circle([0.3, -1.0]), jnp.array([1.0, 2.0, -3.0, 0.5])
    p = acrobot.project_velocity(x, v)
    np.testing.assert_allclose(acrobot.jacobian(x) @ p, np.zeros(2), atol=2e-6)
    np.testing.assert_allclose(acrobot.project_velocity(x, p), p, atol=1e-6)
    # Nearest in the mass metric: what was removed is orthogonal to every tangential velocity.
    tangent = acrobot.project_velocity(x, jnp.array([0.3, -1.0, 2.0, 1.0]))
    assert abs(float(jnp.sum(jnp.repeat(acrobot.masses, 2) * (v - p) * tangent))) < 1e-4


def test_projected_position_keeps_the_constants():
    acrobot = double_pendulum()
    x = on_circle([0.3, -1.0])
    moved = acrobot.project_position(x + 0.1 * jnp.array([1.0, -1.0, 0.5, 1.0]), acrobot.constraint(x))
    np.testing.assert_allclose(acrobot.constraint(moved), acrobot.constraint(x), atol=1e-5)
    assert float(jnp.abs(moved - x).max()) < 0.2


def test_damping_takes_energy_away():
    c = np.array([[0.25, 9.0], [0.1, 0.2]])  # the 9 is above the diagonal and does not count
    damped = double_pendulum(damping=c)
    free = double_pendulum()
    x, v = initial_state(free, on_circle([1.0, 0.2]), jnp.array([1.0, 0.0, -1.0, 2.0])).coordinates
    u = jnp.zeros(0)
    power = jnp.sum(jnp.repeat(free.masses, 2) * v * (accelerate(damped, x, v, u) - accelerate(free, x, v, u)))
    rayleigh = -float(v @ np.kron([[0.25, 0.1], [0.1, 0.2]], np.eye(2)) @ np.asarray(v))
    np.testing.assert_allclose(power, rayleigh, rtol=1e-4)
    assert rayleigh < 0


def test_redundant_constraints_change_nothing():
    items = (DistanceToPoint("elbow"), FixedDistance("elbow", "tip"))
    once = law([1.0, 0.7], Constraints(("elbow", "tip"), items))
    twice = law([1.0, 0.7], Constraints(("elbow", "tip"), (*items, *items)))
    x, v = initial_state(once, on_circle([0.4, 1.9]), jnp.array([1.0, 2.0, 0.3, -1.0])).coordinates
    u = jnp.zeros(0)
    np.testing.assert_allclose(accelerate(twice, x, v, u), accelerate(once, x, v, u), rtol=1e-4)
    np.testing.assert_allclose(twice.project_velocity(x, v + 1), once.project_velocity(x, v + 1), atol=1e-5)


def test_batches_and_gradients():
    acrobot = double_pendulum()
    xs = jnp.stack([on_circle([a, 2 * a]) for a in (0.1, 0.7, 3.0)])
    vs, us = jnp.ones_like(xs), jnp.zeros((3, 0))
    batched = jax.vmap(acrobot.acceleration)(xs, vs, us)
    np.testing.assert_allclose(batched[1], accelerate(acrobot, xs[1], vs[1], us[1]), rtol=1e-5)
    gradient = eqx.filter_grad(lambda law: jnp.sum(jax.vmap(law.acceleration)(xs, vs, us) ** 2))(acrobot)
    assert np.isfinite(gradient.mass.root).all() and np.abs(gradient.mass.root).max() > 0


def test_mistakes():
    with pytest.raises(KeycldError, match="is for 2 coordinates, the system has 4"):
        law([1.0, 1.0], Constraints(("bob",)))
    with pytest.raises(KeycldError, match="'str' is no constraint"):
        ConstrainedLagrangian(PointMasses.ones(1), jnp.sum, None, "pendulum")


def test_number_of_inputs():
    assert pendulum().inputs == 0
    assert cartpole(input_matrix=Uniform(jnp.ones((4, 2)))).inputs == 2
