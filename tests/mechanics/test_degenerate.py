"""Configurations where a constraint says nothing, or too much: finite answers and finite gradients."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import double_pendulum, initial_state, last, law, on_circle, pendulum, rollout

from keycld.mechanics import (
    Constraints,
    DistanceToPoint,
    FixedDistance,
    MechanicalDynamics,
    Motion,
    OnLine,
    Rattle,
    Shake,
    State,
    joining_velocity,
)

ITEMS = (DistanceToPoint("elbow"), FixedDistance("elbow", "tip"))
SYSTEMS = {
    "double pendulum": Constraints(("elbow", "tip"), ITEMS),
    "every constraint twice": Constraints(("elbow", "tip"), (*ITEMS, *ITEMS)),
    "cart without a pole's length": Constraints(("elbow", "tip"), (OnLine("elbow"), FixedDistance("elbow", "tip"))),
    "one degree of freedom": Constraints(("elbow", "tip"), (*ITEMS, OnLine("tip"))),
}
POSITIONS = {
    "both at the pivot": [0.0, 0.0, 0.0, 0.0],
    "elbow at the pivot": [0.0, 0.0, 1.0, 0.5],
    "both at one place": [0.6, 0.8, 0.6, 0.8],
    "nearly at one place": [0.6, 0.8, 0.6, 0.8001],
    "a grain's breadth": [1e-12, 0.0, 0.0, 1e-12],
    "folded": [0.6, 0.8, 0.0, 0.0],
    "stretched": [0.6, 0.8, 1.2, 1.6],
}


@eqx.filter_jit
def everything(dynamics, x, v, constants):
    """Acceleration, projections, roll-out, joining velocity, and the gradient of a roll-out."""
    law, u = dynamics.law, jnp.zeros(0)
    parameters = {"constants": constants}

    def loss(x, v, constants):
        motion = dynamics.rollout(State(Motion(x, v), {"constants": constants}), u, 0.02, 5)
        return jnp.mean(motion.x**2), motion

    (_, motion), gradient = jax.value_and_grad(loss, argnums=(0, 1, 2), has_aux=True)(x, v, constants)
    return {
        "acceleration": law.acceleration(x, v, u, parameters),
        "velocity": law.project_velocity(x, v, parameters),
        "position": law.project_position(x, constants, parameters),
        "joining": joining_velocity(dynamics, x, x + 0.02 * v, parameters, u, 0.02, iterations=1),
        "motion": motion,
        "gradient": gradient,
    }


@pytest.mark.parametrize("name", SYSTEMS)
def test_finite(name):
    system = law([1.0, 0.7], SYSTEMS[name])
    dynamics = MechanicalDynamics(system, Rattle(2))
    for where, x in POSITIONS.items():
        x = jnp.array(x)
        for v in (jnp.zeros(4), jnp.array([1.0, -2.0, 3.0, 0.5])):
            for shift in (0.0, 0.1):  # constants that the initial state satisfies, and others
                found = everything(dynamics, x, v, system.constraint(x) + shift)
                for what, value in found.items():
                    leaves = jax.tree.leaves(value)
                    assert all(np.isfinite(leaf).all() for leaf in leaves), (where, what)
                assert float(jnp.abs(found["motion"].x).max()) < 100


@pytest.mark.parametrize("integrator", [Rattle(), Shake()], ids=["Rattle", "Shake"])
def test_turning_too_fast_for_a_step_is_slowed_down_not_thrown_off(integrator):
    """1000 rad/s at 100 frames a second has no solution on the circle."""
    system = double_pendulum()
    state = initial_state(system, on_circle([0.3, 1.0]), jnp.array([1000.0, 0.0, -1000.0, 500.0]))
    motion = rollout(MechanicalDynamics(system, integrator), state, jnp.zeros(0), 0.01, 200)
    constraint = jax.vmap(system.constraint)(motion.x)
    found = np.abs(np.asarray(constraint) - 1)
    assert found.max() < 0.1 and found[-1].max() < 1e-4


def test_a_start_off_the_constants_finds_them():
    system = pendulum()
    x = 0.02 * on_circle([0.3])
    state = State(Motion(x, jnp.zeros(2)), {"constants": jnp.ones(1)})
    motion = last(rollout(MechanicalDynamics(system, Rattle(4)), state, jnp.zeros(0), 0.02, 10))
    np.testing.assert_allclose(system.constraint(motion.x), [1.0], atol=1e-6)
    assert float(jnp.linalg.norm(motion.v)) < 10
