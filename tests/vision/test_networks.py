import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.vision import KeypointEstimator, LightUNet, PaperUNet, Renderer, Standardise
from keycld.vision.layers import Block, Conv, GroupNorm, depth_to_space, max_pool, space_to_depth, upsample


def test_max_pool_equals_reduce_window(getkey):
    x = jax.random.normal(getkey(), (8, 12, 3))
    expected = jax.lax.reduce_window(x, -jnp.inf, jax.lax.max, (2, 2, 1), (2, 2, 1), "VALID")
    np.testing.assert_array_equal(max_pool(x), expected)


def test_the_gradient_of_max_pool_survives_a_compiler_that_rounds_twice(getkey):
    """Without LLVM's optimisation what is pooled and skips the pool is computed twice, with another rounding."""
    block, frames = Block(3, 8, key=getkey()), jax.random.uniform(getkey(), (4, 16, 16, 3))

    def loss(kernel):
        fine = jax.vmap(eqx.tree_at(lambda block: block.conv.kernel, block, kernel))(frames)
        return jnp.sum(jax.vmap(max_pool)(fine) ** 2) + jnp.sum(fine**2)

    kernel = block.conv.kernel
    gradient = jax.jit(jax.grad(loss)).lower(kernel).compile(compiler_options={"xla_backend_optimization_level": 0})
    assert np.isfinite(gradient(kernel)).all()


def test_upsample_equals_nearest_resize(getkey):
    x = jax.random.normal(getkey(), (4, 6, 3))
    np.testing.assert_array_equal(upsample(x), jax.image.resize(x, (8, 12, 3), "nearest"))


def test_group_norm_gives_each_group_mean_zero_and_variance_one(getkey):
    x = 3 + 5 * jax.random.normal(getkey(), (16, 16, 16))
    groups = GroupNorm(16)(x).reshape(16, 16, 8, 2)
    np.testing.assert_allclose(groups.mean((0, 1, 3)), 0, atol=1e-4)
    np.testing.assert_allclose(groups.var((0, 1, 3)), 1, rtol=1e-3)


def test_space_to_depth_loses_nothing(getkey):
    x = jax.random.normal(getkey(), (8, 12, 3))
    np.testing.assert_array_equal(depth_to_space(space_to_depth(x, 2), 2), x)


def test_convolution_is_a_correlation_with_zero_padding(getkey):
    conv = Conv(1, 1, key=getkey())
    conv = eqx.tree_at(lambda c: c.kernel, conv, jnp.zeros((3, 3, 1, 1)).at[0, 0].set(1.0))
    x = jax.random.normal(getkey(), (4, 4, 1))
    np.testing.assert_array_equal(conv(x)[1:, 1:], x[:-1, :-1])
    np.testing.assert_array_equal(conv(x)[0], 0)


def test_papers_estimator_and_renderer_have_the_papers_number_of_weights(getkey):
    """0.6 M parameters in all, the constant feature maps included (spec of the method)."""
    estimator = KeypointEstimator(PaperUNet(3, 1, 32, key=getkey()), None, stride=1)
    renderer = Renderer(PaperUNet(32, 3, 32, key=getkey()), jnp.zeros((64, 64, 31)), None, 1, 0.1)
    leaves = jax.tree.leaves(eqx.filter((estimator, renderer), eqx.is_array))
    assert 0.55e6 < sum(leaf.size for leaf in leaves) < 0.75e6


@pytest.mark.parametrize(("unet", "stride"), [(PaperUNet, 1), (LightUNet, 2)])
def test_estimator_follows_a_moved_disc(unet, stride, getkey):
    """Fully convolutional: moving the image by a few cells moves the logits with it, away from the border."""
    network = unet(3 * stride**2, 1, 8, key=getkey())
    disc = jnp.zeros((64, 64, 3)).at[28:36, 28:36].set(1.0)
    shift = 4 * stride
    estimator = KeypointEstimator(network, None, stride)
    maps = [estimator(image).heat_maps[0] for image in (disc, jnp.roll(disc, shift, axis=1))]
    logits = [jnp.log(m) for m in maps]
    moved = jnp.roll(logits[0], shift // stride, axis=1)
    centre = slice(24 // stride, 44 // stride)
    difference = (logits[1] - moved)[centre, centre]
    assert float(jnp.std(difference)) < 0.05 * float(jnp.std(logits[0][centre, centre]))


def test_standardised_mean_frame_is_zero_and_statistics_have_no_gradient(getkey):
    mean = jax.random.uniform(getkey(), (8, 8, 3))
    standardise = Standardise(mean, jnp.array(0.1))
    np.testing.assert_array_equal(standardise(mean), 0)
    gradient = jax.grad(lambda s, x: s(x).sum())(standardise, mean + 1)
    assert all(not leaf.any() for leaf in jax.tree.leaves(gradient))


def test_renderer_whose_network_gives_zero_renders_its_background(getkey):
    background = jax.random.uniform(getkey(), (16, 16, 3), minval=0.1, maxval=0.9)
    network = LightUNet(8, 12, 8, key=getkey())
    zero = eqx.tree_at(lambda n: n.out, network, jax.tree.map(jnp.zeros_like, network.out))
    renderer = Renderer(zero, jnp.zeros((8, 8, 7)), background, 2, 0.1)
    np.testing.assert_allclose(renderer(jnp.zeros((1, 2))), background, atol=1e-5)
