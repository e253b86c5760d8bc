"""The convolution equals XLA's own, with its gradients, in every order of transformations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.vision.convolution import convolve, convolve_doubled


def plain(x, kernel, stride):
    return jax.lax.conv_general_dilated(x, kernel, (stride, stride), "SAME", dimension_numbers=("NHWC", "HWIO", "NHWC"))


def example(size, side=9):
    keys = jax.random.split(jax.random.key(size))
    return jax.random.normal(keys[0], (3, side, side + 3, 4)), jax.random.normal(keys[1], (size, size, 4, 5))


def objective(function):
    return lambda x, kernel: jnp.sum(jnp.sin(function(x, kernel)))


@pytest.mark.parametrize(
    ("size", "stride", "side"), [(1, 1, 9), (3, 1, 9), (5, 1, 3), (3, 2, 9), (4, 2, 8), (2, 2, 7), (1, 2, 8)]
)
def test_value_and_gradients(size, stride, side):
    x, kernel = example(size, side)
    ours, theirs = (lambda x, k, f=f: f(x, k, stride) for f in (convolve, plain))
    np.testing.assert_allclose(ours(x, kernel), theirs(x, kernel), atol=1e-5)
    for mine, expected in zip(*(jax.grad(objective(f), (0, 1))(x, kernel) for f in (ours, theirs)), strict=True):
        np.testing.assert_allclose(mine, expected, atol=2e-4)


@pytest.mark.parametrize("side", [1, 4])
def test_doubled_pictures(side):
    """They are never made: value and gradients are those of XLA's convolution of them."""
    x, kernel = example(3, side)

    def theirs(x, kernel):
        return plain(jnp.repeat(jnp.repeat(x, 2, 1), 2, 2), kernel, 1)

    np.testing.assert_allclose(convolve_doubled(x, kernel), theirs(x, kernel), atol=1e-5)
    gradients = (jax.grad(objective(f), (0, 1))(x, kernel) for f in (convolve_doubled, theirs))
    for mine, expected in zip(*gradients, strict=True):
        np.testing.assert_allclose(mine, expected, atol=2e-4)
    kernels = jnp.stack([kernel, 2 * kernel])
    np.testing.assert_allclose(jax.vmap(convolve_doubled, (None, 0))(x, kernels)[1], theirs(x, kernels[1]), atol=1e-4)


@pytest.mark.parametrize("stride", [1, 2])
def test_transformations(stride):
    x, kernel = example(3)
    ours, theirs = (lambda x, k, f=f: f(x[None], k, stride)[0] for f in (convolve, plain))
    for transform in (
        lambda f: jax.grad(lambda k: jnp.sum(jnp.sin(jax.vmap(lambda one: f(one, k))(x))))(kernel),
        lambda f: jax.vmap(jax.grad(objective(f), 1), (0, None))(x, kernel),
        lambda f: jax.vmap(f, (0, None))(x, kernel),
        lambda f: jax.vmap(f, (None, 0))(x[0], jnp.stack([kernel, 2 * kernel])),
        lambda f: jax.vmap(jax.grad(objective(f), (0, 1)), (None, 0))(x[0], jnp.stack([kernel, 2 * kernel])),
        lambda f: jax.jvp(lambda k: f(x[0], k), (kernel,), (0.3 * kernel**2,)),
        lambda f: jax.jacfwd(lambda s: f(s * x[0], kernel))(jnp.array(0.7)),
        lambda f: jax.grad(lambda k: jnp.sum(jax.grad(objective(f))(x[0], k) ** 2))(kernel),
    ):
        for mine, expected in zip(*(jax.tree.leaves(transform(f)) for f in (ours, theirs)), strict=True):
            np.testing.assert_allclose(mine, expected, atol=3e-4, rtol=1e-4)
