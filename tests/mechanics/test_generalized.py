"""Generalised coordinates and the Hamiltonian say the same as the constrained Lagrangian."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_examples import GRAVITY, double_pendulum

from keycld import KeycldError
from keycld.mechanics import (
    GeneralizedLagrangian,
    LegendreLaw,
    MLPFactor,
    MLPInputMatrix,
    MLPPotential,
    PhasePoint,
    momentum,
    pulled_back,
    to_hamiltonian,
)

MASSES = (1.0, 0.7)
U = jnp.array([0.4])


def chain(q):
    first = jnp.stack([jnp.sin(q[0]), -jnp.cos(q[0])])
    return jnp.concatenate([first, first + jnp.stack([jnp.sin(q[1]), -jnp.cos(q[1])])])


def push(x):
    return jnp.stack([x[3], x[0], x[1], -x[2]])[:, None]


@pytest.fixture
def learned(getkey):
    """Networks with weights that matter."""
    law = GeneralizedLagrangian(
        MLPFactor(2, 8, key=getkey()), MLPPotential(2, 8, key=getkey()), MLPInputMatrix(2, 1, 8, key=getkey())
    )
    return jax.tree.map(lambda a: a + 0.4 * jnp.sin(5.0 * jnp.arange(a.size).reshape(a.shape)), law)


Q, V = jnp.array([0.9, -1.4]), jnp.array([0.7, 1.9])


def test_pulled_back_mass_matrix_is_that_of_the_double_pendulum():
    general = pulled_back(double_pendulum(MASSES), chain)
    c = MASSES[1] * np.cos(Q[0] - Q[1])
    expected = [[sum(MASSES), c], [c, MASSES[1]]]
    np.testing.assert_allclose(general.mass_matrix(Q), expected, rtol=1e-5)
    height = -GRAVITY * (sum(MASSES) * np.cos(Q[0]) + MASSES[1] * np.cos(Q[1]))
    np.testing.assert_allclose(general.potential_energy(Q), height, rtol=1e-5)


def test_pulled_back_acceleration_is_the_constrained_one():
    system = double_pendulum(MASSES, input_matrix=push)
    general = pulled_back(system, chain)
    x, v = jax.jvp(chain, (Q,), (V,))
    qdd = general.acceleration(Q, V, U)
    bent = jax.jvp(lambda q: jax.jvp(chain, (q,), (V,))[1], (Q,), (V,))[1]
    a = jax.jvp(chain, (Q,), (qdd,))[1] + bent
    np.testing.assert_allclose(system.acceleration(x, v, U), a, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(general.energy(Q, V), system.energy(x, v), rtol=1e-5)


def test_a_damped_law_has_no_lagrangian():
    with pytest.raises(KeycldError, match="leave the damping out"):
        pulled_back(double_pendulum(damping=jnp.eye(2)), chain)


def test_euler_lagrange_equations_hold(learned):
    """d/dt ∂L/∂q̇ − ∂L/∂q = g u, eq. (4), along the acceleration found."""

    def lagrangian(q, v):
        return learned.kinetic_energy(q, v) - learned.potential_energy(q)

    a = learned.acceleration(Q, V, U)
    rate = jax.jvp(jax.grad(lagrangian, 1), (Q, V), (V, a))[1]
    np.testing.assert_allclose(rate - jax.grad(lagrangian)(Q, V), learned.input_matrix(Q) @ U, atol=1e-4)


def test_mass_matrix_is_positive(learned):
    assert np.linalg.eigvalsh(np.asarray(learned.mass_matrix(Q))).min() > 0
    factor = learned.factor(Q)
    assert float(factor[0, 1]) == 0 and factor.shape == (2, 2)


def test_hamilton_is_lagrange(learned):
    hamiltonian = to_hamiltonian(learned)
    p = momentum(learned, Q, V)
    np.testing.assert_allclose(p, learned.mass_matrix(Q) @ V, rtol=1e-4)
    np.testing.assert_allclose(hamiltonian.energy(Q, p), learned.energy(Q, V), rtol=1e-4)
    qdot, pdot = hamiltonian.derivative(PhasePoint(Q, p), U)
    np.testing.assert_allclose(qdot, V, rtol=1e-3)
    a = learned.acceleration(Q, V, U)
    expected = jax.jvp(lambda q, v: momentum(learned, q, v), (Q, V), (V, a))[1]
    np.testing.assert_allclose(pdot, expected, rtol=1e-3, atol=1e-3)


def test_there_and_back(learned):
    back = LegendreLaw(to_hamiltonian(learned))
    np.testing.assert_allclose(back.momentum(Q, V), momentum(learned, Q, V), rtol=1e-3)
    np.testing.assert_allclose(back.kinetic_energy(Q, V), learned.kinetic_energy(Q, V), rtol=1e-3)
    np.testing.assert_allclose(back.potential_energy(Q), learned.potential_energy(Q), rtol=1e-4)
    a = learned.acceleration(Q, V, U)
    np.testing.assert_allclose(back.acceleration(Q, V, U), a, atol=1e-3 * float(jnp.abs(a).max()))


def test_trainable(learned):
    gradient = eqx.filter_grad(lambda law: jnp.sum(law.acceleration(Q, V, U) ** 2))(learned)
    for leaf in jax.tree.leaves(gradient):
        assert np.isfinite(leaf).all()
    assert float(jnp.abs(gradient.factor.perceptron.kernels[0]).max()) > 0
