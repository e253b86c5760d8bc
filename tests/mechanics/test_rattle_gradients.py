"""Gradients of RATTLE roll-outs against finite differences, in float64."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from mechanics_examples import law, on_circle

from keycld.mechanics import (
    AffineMLPInputMatrix,
    Constraints,
    DistanceToPoint,
    FixedDistance,
    MechanicalDynamics,
    Motion,
    PerceptronPotential,
    Rattle,
    State,
    SumPotential,
)

CONSTRAINTS = Constraints(("elbow", "tip"), (DistanceToPoint("elbow", "pivot"), FixedDistance("elbow", "tip")))


def problem():
    """Everything that training differentiates by: the law, the initial_state, the constants, a pivot, the input."""
    keys = jax.random.split(jax.random.key(0))
    perceptron = PerceptronPotential.zero(CONSTRAINTS, key=keys[0])
    potential = SumPotential(jnp.array([0.3, 6.0, -0.2, 4.0]), {"perceptron": perceptron})
    system = law(
        [1.0, 0.7],
        CONSTRAINTS,
        input_matrix=AffineMLPInputMatrix(4, 1, 8, key=keys[1]),
        damping=jnp.array([[0.25, 0.0], [0.1, 0.2]]),
        potential=potential,
    )
    # Weights large enough to matter.
    system = jax.tree.map(lambda a: a + 0.3 * jnp.sin(7.0 * jnp.arange(a.size).reshape(a.shape)), system)
    x = on_circle([1.0, 2.0])
    pivot = jnp.array([0.1, -0.05])
    constants = system.constraint(x, {"pivot": pivot})
    initial_state = (x, jnp.array([1.0, -0.5, 2.0, 0.3]), constants, pivot, jnp.array([0.6]))
    return MechanicalDynamics(system, Rattle(2)), initial_state


def loss(everything):
    dynamics, (x, v, constants, pivot, u) = everything
    parameters = {"constants": constants, "pivot": pivot}
    v = dynamics.law.project_velocity(x, v, parameters)
    motion = dynamics.rollout(State(Motion(x, v), parameters), u, 0.05, 6)
    return jnp.sum(motion.x**3) + jnp.sum(motion.x[3] * motion.x[5])


def test_against_differences():
    """With damping, which RATTLE adds to what it does without."""
    with jax.enable_x64(True):
        everything = problem()
        arrays, rest = eqx.partition(everything, eqx.is_inexact_array)
        flat, unflatten = jax.flatten_util.ravel_pytree(arrays)
        f = jax.jit(lambda flat: loss(eqx.combine(unflatten(flat), rest)))
        gradient = jax.jit(jax.grad(f))(flat)
        for k in range(4):
            direction = jnp.asarray(np.random.default_rng(k).normal(size=flat.shape))
            difference = (f(flat + 1e-6 * direction) - f(flat - 1e-6 * direction)) / 2e-6
            np.testing.assert_allclose(gradient @ direction, difference, rtol=1e-4)
