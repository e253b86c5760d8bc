"""Adaptive roll-outs agree with fixed steps and stay on the constraints."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import double_pendulum, initial_state, law, on_circle, pendulum, rollout

from keycld import KeycldError
from keycld.mechanics import (
    AdaptiveDynamics,
    MechanicalDynamics,
    Motion,
    PhasePoint,
    Rattle,
    SeparableHamiltonian,
    State,
    adaptive_rollout,
)

adaptive = eqx.filter_jit(adaptive_rollout)


def push(x):
    return jnp.stack([x[3], x[0], x[1], -x[2]])[:, None]


def test_follows_rattle_on_the_constraints_and_comes_back():
    system = double_pendulum(input_matrix=push)
    state = initial_state(system, on_circle([1.0, 0.3]), jnp.ones(4))
    u = jnp.asarray(np.random.default_rng(0).normal(size=(40, 1)), float)
    dt = jnp.asarray(0.02)
    motion = adaptive(system, state, u, dt, 40)
    assert motion.x.shape == (41, 4)
    expected = rollout(MechanicalDynamics(system, Rattle(16)), state, u, dt, 40)
    np.testing.assert_allclose(motion.x, expected.x, atol=1e-3)
    constraint = jax.vmap(system.constraint)(motion.x)
    np.testing.assert_allclose(constraint, np.ones((41, 2)), atol=1e-4)
    last = State(Motion(motion.x[-1], motion.v[-1]), state.parameters)
    np.testing.assert_allclose(adaptive(system, last, u, -dt, 40).x[-1], state.coordinates.x, atol=1e-3)


@pytest.mark.parametrize(("pull_back", "radius"), [(True, 1.1), (False, 1.0)])
def test_pulling_back_evaluates_the_field_on_the_constants(pull_back, radius):
    """A bob at the lowest point of a unit circle, whose state says 1.1: v²/r upward, with r of v1 or of 2024."""
    system = pendulum()
    bob = State(Motion(on_circle([0.0]), jnp.array([2.0, 0.0])), {"constants": jnp.array([1.1**2])})
    after = AdaptiveDynamics(system, pull_back=pull_back).step(bob, jnp.zeros(0), 1e-3).coordinates
    np.testing.assert_allclose(after.v[1], 1e-3 * 2.0**2 / radius, rtol=2e-3)
    assert AdaptiveDynamics(system).pull_back


def test_follows_a_hamiltonian():
    """Any field of first order: H = (p² + q²)/2 turns phase space clockwise."""
    system = SeparableHamiltonian(lambda p: jnp.sum(p**2) / 2, lambda q: jnp.sum(q**2) / 2)
    path = adaptive(system, State(PhasePoint(jnp.ones(1), jnp.zeros(1)), {}), jnp.zeros(0), 0.1, 30)
    t = 0.1 * np.arange(31)
    np.testing.assert_allclose(path.q[:, 0], np.cos(t), atol=1e-4)
    np.testing.assert_allclose(path.p[:, 0], -np.sin(t), atol=1e-4)


def test_free_fall():
    system = law([1.0], None)
    state = State(Motion(jnp.zeros(2), jnp.array([1.0, 2.0])), {})
    height = adaptive(system, state, jnp.zeros(0), 0.1, 5).x[-1, 1]
    np.testing.assert_allclose(height, 2.0 * 0.5 - 9.81 / 2 * 0.25, rtol=1e-4)


def test_a_motion_that_diverges_is_not_a_number_and_harms_no_other():
    """a = v² x⁴ reaches infinity in finite time."""
    system = law([1.0], None, potential=lambda x: -1e4 * jnp.sum(x**4))
    still = State(Motion(jnp.array([[0.0, 0.0], [9.0, 9.0]]), jnp.zeros((2, 2))), {})
    height = jax.vmap(lambda state: adaptive(system, state, jnp.zeros(0), 0.5, 3).x)(still)
    assert np.all(height[0] == 0) and np.isnan(height[1, -1]).all()


def test_mistakes():
    system = law([1.0], None)
    with pytest.raises(KeycldError, match="5 steps needs 5 inputs, not 4"):
        adaptive_rollout(system, State(Motion(jnp.zeros(2), jnp.zeros(2)), {}), jnp.zeros((4, 0)), 0.1, 5)
