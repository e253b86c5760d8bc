import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.mechanics import Linear, SwishEnergy, SwishMLP, begin_as_identity, lecun_normal, truncated_normal


def test_kernels_have_haikus_deviation_and_no_tails(getkey):
    """N(0, 1/fan_in) cut at two deviations has 0.8796 of the deviation, and Haiku does not make up for it."""
    kernel = truncated_normal(getkey(), (400, 500)) * np.sqrt(400)
    assert float(jnp.abs(kernel).max()) <= 2.0
    assert float(kernel.std()) == pytest.approx(0.8796, rel=0.01)


@pytest.mark.parametrize("shape", [(3, 5), (144, 16), (400, 500)])
def test_kernels_are_the_numbers_that_jax_samples(shape, getkey):
    """Of a row that is longer, so that all shapes share a program."""
    key = getkey()
    expected = jax.nn.initializers.lecun_normal()(key, shape)
    np.testing.assert_allclose(lecun_normal(key, shape), expected, rtol=1e-6)
    np.testing.assert_allclose(truncated_normal(key, shape), 0.87962566 * expected, rtol=1e-6)


def test_a_perceptron_is_swish_between_affine_maps(getkey):
    network = SwishMLP(3, 2, hidden=5, depth=2, key=getkey())
    x = jax.random.normal(getkey(), (3,))
    y = np.asarray(x, np.float64)
    for k, layer in enumerate(network.layers):
        y = y @ np.asarray(layer.kernel, np.float64) + np.asarray(layer.bias, np.float64)
        y = y / (1 + np.exp(-y)) if k < 2 else y
    np.testing.assert_allclose(network(x), y, rtol=1e-5)


def test_networks_of_the_benchmark_have_its_numbers_of_weights(getkey):
    for network, expected in ((SwishEnergy(16, key=getkey()), 192_751), (SwishMLP(32, 32, key=getkey()), 204_532)):
        assert sum(leaf.size for leaf in jax.tree.leaves(network)) == expected


def test_an_empty_layer_is_refused(getkey):
    with pytest.raises(KeycldError, match="at least one input"):
        Linear(0, 3, key=getkey())


@pytest.mark.parametrize(("hidden", "depth"), [(250, 4), (71, 1)])
def test_a_network_may_begin_as_the_identity(getkey, hidden, depth):
    """It is linear at first, and nothing of a state is lost in two hundred applications."""
    network = begin_as_identity(SwishMLP(34, 32, hidden, depth, key=getkey()), key=getkey())
    x, u = jax.random.normal(getkey(), (32,)), jnp.array([0.3, -2.0])
    again, _ = jax.lax.scan(lambda s, _: (network(jnp.concatenate([s, u])), None), x, length=200)
    np.testing.assert_allclose(again, x, atol=2e-3)
    kernels = [np.asarray(layer.kernel) for layer in network.layers]
    assert all(kernel.std() > 0.01 for kernel in kernels)


def test_too_few_units_for_the_identity_are_refused(getkey):
    with pytest.raises(KeycldError, match="identity of 4 numbers has at least 8 hidden units and at most 4 outputs"):
        begin_as_identity(SwishMLP(4, 4, 7, 2, key=getkey()), key=getkey())
