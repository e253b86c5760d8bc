"""The small networks of mass, potential and input matrix."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld import KeycldError
from keycld.mechanics import (
    AffineMLPInputMatrix,
    CoupledMasses,
    MLPInputMatrix,
    MLPPotential,
    PointMasses,
    SumPotential,
)

X = jnp.array([0.3, -0.2, 0.5, 0.7])


def test_layers_and_first_weights_are_the_papers(getkey):
    potential = MLPPotential(4, key=getkey())
    assert [k.shape for k in potential.perceptron.kernels] == [(4, 32), (32, 32), (32, 1)]
    kernels = np.concatenate([np.ravel(k) for k in potential.perceptron.kernels])
    assert abs(kernels.mean()) < 1e-3 and 0.009 < kernels.std() < 0.011
    assert all((np.asarray(b) == 0).all() for b in potential.perceptron.biases)
    g = MLPInputMatrix(4, 2, key=getkey())
    assert g.perceptron.kernels[-1].shape == (32, 8) and g(X).shape == (4, 2)


def test_masses_are_positive_and_one_by_default():
    np.testing.assert_array_equal(PointMasses.ones(3).matrix, np.eye(3))
    np.testing.assert_allclose(PointMasses(jnp.array([-2.0, 0.5])).matrix, np.diag([4.0, 0.25]))


def test_v1_samples_roots_of_masses_near_zero(getkey):
    roots = np.asarray(PointMasses.near_zero(2000, key=getkey()).root)
    assert abs(roots.mean()) < 1e-3 and roots.std() == pytest.approx(0.01, rel=0.05)
    with pytest.raises(KeycldError, match="at least one keypoint"):
        PointMasses.near_zero(0, key=getkey())


def test_a_coupled_mass_matrix_is_positive_and_undoes_its_inverse():
    masses = CoupledMasses(jnp.array([[0.5, 9.0], [0.3, -0.8]]))  # what is above the diagonal does not count
    np.testing.assert_allclose(masses.inverse, [[0.25, 0.15], [0.15, 0.73]], rtol=1e-6)
    np.testing.assert_allclose(masses.matrix @ masses.inverse, np.eye(2), atol=1e-6)
    assert (np.linalg.eigvalsh(masses.matrix) > 0).all()
    np.testing.assert_array_equal(CoupledMasses.ones(2).matrix, np.eye(2))
    with pytest.raises(KeycldError, match="at least one keypoint"):
        PointMasses.ones(0)


def test_affine_parts(getkey):
    w = jnp.array([0.0, 9.81, 0.0, 4.9])
    np.testing.assert_allclose(jax.grad(SumPotential(w, {}))(X), w, rtol=1e-6)
    g = AffineMLPInputMatrix(4, 2, key=getkey())
    np.testing.assert_allclose(g(X), g.perceptron(X))
    a, b = jnp.arange(32.0).reshape(8, 4), jnp.arange(8.0)
    affine = eqx.tree_at(lambda g: (g.weight, g.bias), g, (a, b))
    np.testing.assert_allclose(affine(X) - g(X), (a @ X + b).reshape(4, 2), rtol=1e-4)


def test_no_input(getkey):
    for g in (MLPInputMatrix(4, 0, key=getkey()), AffineMLPInputMatrix(4, 0, key=getkey())):
        assert g(X).shape == (4, 0)
        np.testing.assert_array_equal(g(X) @ jnp.zeros(0), np.zeros(4))


def test_forces_are_continuous(getkey):
    """The gradient of the energy does not jump where a unit changes sign."""
    potential = MLPPotential(1, 16, key=getkey())
    potential = jax.tree.map(lambda a: a + jnp.sin(5.0 * jnp.arange(a.size).reshape(a.shape)), potential)
    grid = jnp.linspace(-2, 2, 4001)[:, None]
    force = jax.vmap(jax.grad(potential))(grid)[:, 0]
    assert float(jnp.abs(jnp.diff(force)).max()) < 0.01 * float(jnp.abs(force).max())


def test_a_layer_has_units(getkey):
    with pytest.raises(KeycldError, match="at least one unit"):
        MLPPotential(4, 0, key=getkey())
