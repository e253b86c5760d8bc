"""The velocity that joins two frames."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import cartpole, double_pendulum, end, initial_state, law, on_circle, pendulum

from keycld.mechanics import RK4, MechanicalDynamics, Motion, Rattle, State, joining_velocity

joining = eqx.filter_jit(joining_velocity)
SYSTEMS = {
    "pendulum": (pendulum, on_circle([0.7]), 25.0),
    "double pendulum": (double_pendulum, on_circle([0.7, 2.0]), 15.0),
    "cartpole": (cartpole, jnp.array([0.2, 0.0, 0.8, 0.8]), 15.0),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_finds_the_velocity_that_was_there(name):
    """Up to half a radian a frame, as the fastest runs of the benchmark turn."""
    make, x, speed = SYSTEMS[name]
    dynamics = MechanicalDynamics(make(), Rattle(4))
    state = initial_state(dynamics.law, x, speed * jnp.array([0.8, 0.6, -0.9, 0.3])[: len(x)])
    there = end(dynamics, state, jnp.zeros(0), 0.02, 1)
    found = joining(dynamics, x, there.coordinates.x, state.parameters, jnp.zeros(0), 0.02)
    np.testing.assert_allclose(found, state.coordinates.v, atol=2e-5 * speed)


def test_without_constraints_and_with_input():
    system = law([1.0], None, input_matrix=lambda x: jnp.stack([x[1], -x[0]])[:, None])
    dynamics = MechanicalDynamics(system, RK4())
    state = initial_state(system, jnp.array([0.3, 0.5]), jnp.array([2.0, -1.0]))
    u = jnp.array([1.5])
    there = end(dynamics, state, u, 0.05, 1)
    found = joining(dynamics, state.coordinates.x, there.coordinates.x, state.parameters, u, 0.05)
    np.testing.assert_allclose(found, state.coordinates.v, atol=1e-5)


def test_noisy_frames():
    """Observed points lie off the constraints: the velocity is tangential, and the arrival the nearest."""
    system = double_pendulum()
    dynamics = MechanicalDynamics(system, Rattle(4))
    x0, x1 = on_circle([0.7, 2.0]), on_circle([0.75, 1.9]) + 0.01 * jnp.array([1.0, -1.0, 2.0, 0.5])
    parameters = {"constants": system.constraint(x0)}
    v = joining(dynamics, x0, x1, parameters, jnp.zeros(0), 0.02)
    np.testing.assert_allclose(system.jacobian(x0) @ v, np.zeros(2), atol=1e-5)
    reached = end(dynamics, State(Motion(x0, v), parameters), jnp.zeros(0), 0.02, 1).coordinates.x
    np.testing.assert_allclose(system.project_velocity(reached, x1 - reached), np.zeros(4), atol=1e-5)


def test_derivatives():
    """Against differences; also where the two frames are the same."""
    with jax.enable_x64(True):
        system = double_pendulum()
        dynamics = MechanicalDynamics(system, Rattle())
        x0 = jnp.asarray(on_circle([0.7, 2.0]), jnp.float64)
        parameters = {"constants": system.constraint(x0)}

        def speed(frames):
            v = joining_velocity(dynamics, frames[0], frames[1], parameters, jnp.zeros(0), 0.02, iterations=2)
            return jnp.sum(v**2)

        both = jax.jit(jax.value_and_grad(speed))
        for x1 in (x0, jnp.asarray(on_circle([0.8, 2.1]), jnp.float64)):
            frames = jnp.stack([x0, x1])
            for seed in range(3):
                direction = jnp.asarray(np.random.default_rng(seed).normal(size=(2, 4)))
                ahead, behind = (both(frames + step * direction)[0] for step in (1e-6, -1e-6))
                slope = jnp.sum(both(frames)[1] * direction)
                np.testing.assert_allclose(slope, (ahead - behind) / 2e-6, rtol=1e-4, atol=1e-6)
