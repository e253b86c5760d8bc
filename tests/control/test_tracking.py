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
from keycld.control.planning import Planner
from keycld.mechanics import AbstractDynamics, Motion, State


def in_mujoco(known, controller, state, seconds, limit):
    """With true states: states after each frame, inputs, the controller's memory at the end."""
    believe = jax.jit(lambda state: Belief(known.motion(state), 0 * known.upright, jnp.asarray(9)))
    act = eqx.filter_jit(controller.act)
    state, memory, states, inputs = np.array([state]), controller.initial_memory(), [], []
    for _ in range(round(seconds / known.system.dt)):
        belief = believe(jnp.asarray(state[0], float))
        u, memory = act(belief, memory)
        u = np.clip(np.asarray(u), -limit, limit)
        one = jax.tree.map(lambda leaf: leaf[None], (belief, memory))
        memory = jax.tree.map(lambda leaf: leaf[0], controller.replan(*one, u[None]))
        state = advance(known.system, state, u[None])
        states.append(state[0])
        inputs.append(u)
    return np.array(states), np.array(inputs), memory


@pytest.mark.slow
def test_a_motor_too_weak_to_lift_swings_the_pendulum_up():
    """|u| ≤ 1 is 2 N m, gravity needs 4.9: the plan must swing. It hangs at first."""
    known = truth("pendulum")
    controller = PlanAndTrack.towards(known.law, known.upright, (0,), 1.0, known.system.dt, seconds=3.0)
    states, _, memory = in_mujoco(known, controller, [np.pi - 0.1, 0.0], 6, 1.0)
    assert upright(known.system, states[-50:]).all()
    np.testing.assert_allclose(memory.plan.z[-1], jnp.concatenate([known.upright, 0 * known.upright]), atol=0.1)
    assert np.abs(memory.plan.u).max() <= 0.95 + 1e-6


@pytest.mark.slow
def test_the_elbow_alone_swings_the_acrobot_up():
    """One motor, two links, ±6 N m against 20 N m of gravity; upright it can lean by 7° and be caught."""
    known = truth("acrobot")
    controller = PlanAndTrack.towards(known.law, known.upright, (1,), 3.0, known.system.dt)
    states, inputs, _ = in_mujoco(known, controller, [np.pi - 0.2, 0.3, 0.0, 0.0], 6, 3.0)
    assert upright(known.system, states[-100:]).all()
    assert not inputs[:, 0].any()


def test_a_plan_is_refined_from_where_the_system_is():
    """A push on the way: the refined plan contains the pushed state and still ends at the goal."""
    known = truth("pendulum")
    controller = PlanAndTrack.towards(known.law, known.upright, (0,), 1.0, known.system.dt, seconds=3.0)
    _, _, memory = in_mujoco(known, controller, [np.pi - 0.1, 0.0], 0.24, 1.0)
    assert memory.clock < controller.refresh
    old = memory.plan.z[memory.age]
    pushed = jnp.concatenate(known.motion(jnp.asarray([np.pi - 0.1, 0.3])).coordinates)
    refined = controller.planner.refine(
        pushed,
        memory.plan,
        memory.age,
        jnp.asarray(controller.planner.arrival),
        controller.gain,
        known.law.constraint(known.upright),
        controller.ahead,
    )
    np.testing.assert_array_equal(refined.z[0], pushed)
    assert np.abs(refined.z[0] - old).max() > 0.01
    np.testing.assert_allclose(refined.z[-1, :2], known.upright, atol=0.02)


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


class Cliff(AbstractDynamics):
    """A mass of 1 that a force pushes along x; what goes beyond 0.25 is lost."""

    def step(self, state, u, dt):
        x, v = state.coordinates
        v = v + dt * jnp.concatenate([u, 0 * u])
        x = x + dt * v
        return State(Motion(x, jnp.where(jnp.abs(x[0]) > 0.25, jnp.nan, v)), state.parameters)


def test_a_guess_that_diverges_costs_no_plan():
    """One of the four first motions leaves the cliff; the other three find the goal."""
    planner = Planner(Cliff(), jnp.array([0.03, 0.0, 0.0, 0.0]), (0,), 1, 1.0, 0.05, 40, 5, iterations=20)
    plan = planner(jnp.zeros(4), jnp.zeros(0), jnp.eye(4))
    assert plan.cost < 0.01 and np.isfinite(plan.u).all()
    np.testing.assert_allclose(plan.z[-1], planner.goal, atol=0.01)
