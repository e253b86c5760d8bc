import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.mechanics import Linear, SwishEnergy, SwishMLP, truncated_normal


def test_kernels_have_haikus_deviation_and_no_tails(getkey):
    """N(0, 1/fan_in) cut at two deviations has 0.8796 of the deviation, and Haiku does not make up for it."""
    kernel = truncated_normal(getkey(), (400, 500)) * np.sqrt(400)
    assert float(jnp.abs(kernel).max()) <= 2.0
    assert float(kernel.std()) == pytest.approx(0.8796, rel=0.01)


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
