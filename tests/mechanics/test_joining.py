"""The velocity that joins two frames."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import cartpole, double_pendulum, end, law, on_circle, pendulum, start

from keycld.mechanics import RK4, MechanicalDynamics, Motion, Rattle, State, joining_velocity

joining = eqx.filter_jit(joining_velocity)
SYSTEMS = {
    "pendulum": (pendulum, on_circle([0.7]), 25.0),
    "double pendulum": (double_pendulum, on_circle([0.7, 2.0]), 15.0),
    "cartpole": (cartpole, jnp.array([0.2, 0.0, 0.8, 0.8]), 15.0),
}


@pytest.mark.parametrize("integrator", [Rattle(4), RK4(2)], ids=["Rattle", "RK4"])
@pytest.mark.parametrize("name", SYSTEMS)
def test_finds_the_velocity_that_was_there(name, integrator):
    """Up to half a radian a frame, as the fastest runs of the benchmark turn."""
    make, x, speed = SYSTEMS[name]
    dynamics = MechanicalDynamics(make(), integrator)
    state = start(dynamics.law, x, speed * jnp.array([0.8, 0.6, -0.9, 0.3])[: len(x)])
    there = end(dynamics, state, jnp.zeros(0), 0.02, 1)
    found = joining(dynamics, x, there.coordinates.x, state.parameters, jnp.zeros(0), 0.02)
    np.testing.assert_allclose(found, state.coordinates.v, atol=2e-5 * speed)


def test_without_constraints_and_with_input():
    system = law([1.0], None, input_matrix=lambda x: jnp.stack([x[1], -x[0]])[:, None])
    dynamics = MechanicalDynamics(system, Rattle(2))
    state = start(system, jnp.array([0.3, 0.5]), jnp.array([2.0, -1.0]))
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


@pytest.mark.parametrize("x1", [on_circle([0.7, 2.0]), on_circle([0.8, 2.1])], ids=["at rest", "moving"])
def test_derivatives(x1):
    """Against differences; finite where the frames are the same."""
    with jax.enable_x64(True):
        system = double_pendulum()
        dynamics = MechanicalDynamics(system, Rattle(2))
        x0, x1 = (jnp.asarray(a, jnp.float64) for a in (on_circle([0.7, 2.0]), x1))
        parameters = {"constants": system.constraint(x0)}

        def speed(x0, x1):
            return jnp.sum(joining(dynamics, x0, x1, parameters, jnp.zeros(0), 0.02) ** 2)

        direction = jnp.array([0.3, -0.2, 0.5, 0.7])
        for argument in (0, 1):
            slope = jax.grad(speed, argument)(x0, x1) @ direction
            moved = [(x0, x1), (x0, x1)]
            step = 1e-6 * direction
            moved = [tuple(x + sign * step * (k == argument) for k, x in enumerate((x0, x1))) for sign in (1, -1)]
            difference = (speed(*moved[0]) - speed(*moved[1])) / 2e-6
            np.testing.assert_allclose(slope, difference, rtol=1e-4, atol=1e-6)
