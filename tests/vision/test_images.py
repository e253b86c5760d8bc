"""Encoder and decoder of "Which priors matter?"."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.vision import ImageDecoder, ImageEncoder, mean_in_chunks


def weights(module):
    return sum(leaf.size for leaf in jax.tree.leaves(module))


@pytest.mark.parametrize(("inputs", "outputs", "expected"), [(15, 64, 295_872), (3, 32, 221_312)])
def test_encoder_has_the_benchmarks_number_of_weights(inputs, outputs, expected, getkey):
    """Five stacked frames to mean and scale of 32 numbers; single frames to 32 numbers (released configuration)."""
    assert weights(ImageEncoder((32, 32), inputs, outputs, key=getkey())) == expected


@pytest.mark.parametrize(("inputs", "expected"), [(16, 201_187), (32, 205_283)])
def test_decoder_has_the_benchmarks_number_of_weights(inputs, expected, getkey):
    assert weights(ImageDecoder((32, 32), inputs, 16, key=getkey())) == expected


def test_larger_pictures_get_a_block_more(getkey):
    small, large = (ImageEncoder((side, side), 3, 8, 8, key=getkey()) for side in (32, 64))
    assert len(large.convolutions) == len(small.convolutions) + 2
    assert large(jnp.zeros((64, 64, 3))).shape == (8,)
    assert ImageDecoder((64, 32), 8, 4, 8, key=getkey())(jnp.zeros(8)).shape == (64, 32, 3)
    with pytest.raises(KeycldError, match="multiples of"):
        ImageEncoder((30, 30), 3, 8, key=getkey())


def test_strided_convolution_is_every_second_value_of_the_dense_one(getkey):
    """SAME padding of an even side begins with the second pixel, as TensorFlow and Haiku have it."""
    encoder = ImageEncoder((8, 8), 3, 4, 4, key=getkey())
    first = encoder.convolutions[0]
    x = jax.random.normal(getkey(), (8, 8, 3))
    dense = jax.lax.conv_general_dilated(
        x[None], first.kernel, (1, 1), "SAME", dimension_numbers=("NHWC", "HWIO", "NHWC")
    )[0]
    np.testing.assert_allclose(first(x), dense[1::2, 1::2], atol=1e-5)


def test_untrained_decoder_shows_values_near_the_middle(getkey):
    picture = ImageDecoder((32, 32), 16, 16, key=getkey())(jnp.zeros(16))
    assert float(jnp.abs(picture - 0.5).max()) < 0.4


def test_chunks_give_the_same_mean_and_gradients(getkey):
    """Seven pictures two at a time, the last one alone."""
    decoder = ImageDecoder((8, 8), 4, 4, 8, key=getkey())
    codes, targets = jax.random.normal(getkey(), (7, 4)), jax.random.uniform(getkey(), (7, 8, 8, 3))

    def error(decoder, pair):
        return jnp.sum((decoder(pair[0]) - pair[1]) ** 2)

    def loss(inputs, at_once):
        decoder, codes = inputs
        return 3.0 * mean_in_chunks(error, decoder, (codes, targets), at_once)

    whole, parts = (jax.jit(jax.value_and_grad(lambda i, n=n: loss(i, n)))((decoder, codes)) for n in (7, 2))
    for one, other in zip(jax.tree.leaves(whole), jax.tree.leaves(parts), strict=True):
        np.testing.assert_allclose(other, one, rtol=2e-4, atol=1e-4)


@pytest.mark.slow
def test_memory_is_that_of_one_chunk(getkey):
    decoder = ImageDecoder((16, 16), 4, 4, 16, key=getkey())
    pairs = (jnp.zeros((64, 4)), jnp.zeros((64, 16, 16, 3)))

    def error(decoder, pair):
        return jnp.sum((decoder(pair[0]) - pair[1]) ** 2)

    def memory(at_once):
        gradient = jax.jit(jax.grad(lambda d: mean_in_chunks(error, d, pairs, at_once)))
        return gradient.lower(decoder).compile().memory_analysis().temp_size_in_bytes

    assert memory(8) < memory(64) / 3
