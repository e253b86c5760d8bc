"""Planned motions under inputs that are too weak to lift, and the feedback that keeps them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from true_physics import truth

from keycld import KeycldError
from keycld.control import Belief, PlanAndTrack, Weights, advance, stationary_gain, upright
from keycld.control.lqr import frame_step


@pytest.fixture(scope="module")
def weak_pendulum():
    known = truth("pendulum")
    return known, PlanAndTrack.towards(known.law, known.upright, (0,), 1.0, known.system.dt, seconds=3.0)


def test_a_motor_too_weak_to_lift_swings_the_pendulum_up(weak_pendulum):
    """|u| ≤ 1 is 2 N m, gravity needs 4.9: the plan must swing. Flown in MuJoCo from true states, started hanging."""
    known, controller = weak_pendulum
    begin = jax.jit(lambda z: Belief(known.motion(z), 0 * known.upright, jnp.asarray(9)))
    act = eqx.filter_jit(controller.act)
    state, memory, angles, inputs = np.array([[np.pi - 0.1, 0.0]]), controller.begin(), [], []
    for _ in range(round(6 / known.system.dt)):
        belief = begin(jnp.asarray(state[0], float))
        u, memory = act(belief, memory)
        u = np.clip(np.asarray(u), -1, 1)
        one = jax.tree.map(lambda leaf: leaf[None], (belief, memory))
        memory = jax.tree.map(lambda leaf: leaf[0], controller.attend(*one, u[None]))
        state = advance(known.system, state, u[None])
        angles.append(state[0])
        inputs.append(u)
    assert upright(known.system, np.array(angles[-50:])).all()
    assert np.abs(inputs).max() <= 1
    np.testing.assert_allclose(memory.plan.z[-1], jnp.concatenate([known.upright, 0 * known.upright]), atol=0.1)
    assert np.abs(memory.plan.u).max() <= 0.7 + 1e-6


@pytest.mark.parametrize(("name", "actuators"), [("pendulum", (0,)), ("cartpole", (0,)), ("acrobot", (1,))])
def test_stationary_feedback_holds_what_falls_by_itself(name, actuators):
    known = truth(name)
    inputs = len(known.system.input_names)
    constants = known.law.constraint(known.upright)
    args = (known.dynamics, known.upright, jnp.zeros(inputs), constants, actuators, known.system.dt)
    gain, ahead = stationary_gain(*args, Weights(0.03, 0.3, 3.0))
    z = jnp.concatenate([known.upright, 0 * known.upright])
    a, b = jax.jit(jax.jacfwd(lambda z, u: frame_step(known.dynamics, z, u, constants, known.system.dt), (0, 1)))(
        z, jnp.zeros(inputs)
    )
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)[:, list(actuators)]
    assert np.abs(np.linalg.eigvals(a)).max() > 1.02
    assert np.abs(np.linalg.eigvals(a - b @ gain)).max() < 0.999
    np.testing.assert_allclose(ahead, ahead.T, rtol=1e-6)


def test_an_input_without_effect_cannot_hold():
    known = truth("pendulum")
    law = type(known.law)(
        known.law.mass, known.law.potential, lambda x: jnp.zeros((2, 1)), known.law.constraint_function
    )
    with pytest.raises(KeycldError, match="cannot hold the goal"):
        PlanAndTrack.towards(law, known.upright, (0,), 1.0, known.system.dt)
    with pytest.raises(KeycldError, match="needs an input limit"):
        PlanAndTrack.towards(known.law, known.upright, (0,), np.inf, known.system.dt)
