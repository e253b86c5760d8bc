"""The small networks of mass, potential and input matrix."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld import KeycldError
from keycld.mechanics import (
    AffineMLPInputMatrix,
    AffineMLPPotential,
    MLPInputMatrix,
    MLPPotential,
    PointMasses,
)

X = jnp.array([0.3, -0.2, 0.5, 0.7])


def test_layers_and_start_are_the_papers(getkey):
    potential = MLPPotential(4, key=getkey())
    assert [k.shape for k in potential.perceptron.kernels] == [(4, 32), (32, 32), (32, 1)]
    kernels = np.concatenate([np.ravel(k) for k in potential.perceptron.kernels])
    assert abs(kernels.mean()) < 1e-3 and 0.009 < kernels.std() < 0.011
    assert all((np.asarray(b) == 0).all() for b in potential.perceptron.biases)
    g = MLPInputMatrix(4, 2, key=getkey())
    assert g.perceptron.kernels[-1].shape == (32, 8) and g(X).shape == (4, 2)


def test_masses_are_positive_and_start_at_one():
    np.testing.assert_array_equal(PointMasses.ones(3).masses, np.ones(3))
    np.testing.assert_allclose(PointMasses(jnp.array([-2.0, 0.5])).masses, [4.0, 0.25])
    with pytest.raises(KeycldError, match="at least one keypoint"):
        PointMasses.ones(0)


def test_affine_parts(getkey):
    plain = AffineMLPPotential(4, key=getkey())
    np.testing.assert_allclose(plain(X), plain.perceptron(X)[0])
    w = jnp.array([0.0, 9.81, 0.0, 4.9])
    tilted = eqx.tree_at(lambda p: p.weight, plain, w)
    np.testing.assert_allclose(jax.grad(tilted)(X) - jax.grad(plain)(X), w, rtol=1e-6)
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
