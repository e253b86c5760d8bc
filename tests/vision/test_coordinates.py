import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.vision import gaussian_maps, image_grid, pixel_size, spatial_softmax


def test_corner_pixels_of_a_square_image_are_plus_minus_one():
    grid = image_grid(64, 64)
    assert grid.shape == (64, 64, 2)
    np.testing.assert_allclose(grid[0, 0], [-1, 1], atol=1e-6)
    np.testing.assert_allclose(grid[-1, -1], [1, -1], atol=1e-6)
    np.testing.assert_allclose(grid[0, 1] - grid[0, 0], [2 / 63, 0], atol=1e-6)


def test_grid_is_isotropic_and_the_shorter_side_is_one():
    grid = image_grid(32, 64)
    np.testing.assert_allclose(grid[0, 0, 1], 1, atol=1e-6)
    np.testing.assert_allclose(grid[0, -1, 0], 63 / 31, atol=1e-6)
    np.testing.assert_allclose(grid[0, 1] - grid[0, 0], [pixel_size(32, 64), 0], atol=1e-6)


def test_coarse_cells_lie_in_the_middle_of_their_pixels():
    fine, coarse = image_grid(16, 24), image_grid(16, 24, stride=2)
    middle = fine.reshape(8, 2, 12, 2, 2).mean((1, 3))
    np.testing.assert_allclose(coarse, middle, atol=1e-6)


@pytest.mark.parametrize("stride", [1, 2])
def test_softmax_of_a_blob_finds_its_centre_between_pixels(stride):
    grid = image_grid(64, 64, stride)
    centre = jnp.array([[0.213, -0.377]])
    logits = jnp.log(gaussian_maps(centre, grid, 0.1) + 1e-20)
    found, maps = spatial_softmax(logits, grid)
    np.testing.assert_allclose(found, centre, atol=2e-3)  # a fifteenth of a pixel
    np.testing.assert_allclose(maps.sum((0, 1)), 1, rtol=1e-5)


def test_gaussian_is_equation_nine():
    grid = image_grid(8, 8)
    x = jnp.array([[0.1, 0.7], [-0.3, 0.2]])
    expected = jnp.exp(-jnp.sum((grid[:, :, None, :] - x[None, None]) ** 2, -1) / (2 * 0.1**2))
    np.testing.assert_allclose(gaussian_maps(x, grid, 0.1), expected, atol=1e-6)


def test_shifting_the_logits_by_a_pixel_shifts_the_keypoint_by_two_over_63():
    grid = image_grid(64, 64)
    logits = 30 * gaussian_maps(jnp.array([[0.0, 0.0]]), grid, 0.1)
    shifted, _ = spatial_softmax(jnp.roll(logits, 1, axis=1), grid)
    still, _ = spatial_softmax(logits, grid)
    np.testing.assert_allclose(shifted - still, [[2 / 63, 0]], atol=1e-5)


def test_softmax_has_finite_gradients_for_huge_logits():
    grid = image_grid(8, 8)
    logits = jnp.zeros((8, 8, 1)).at[2, 3, 0].set(1e4)
    gradient = jax.grad(lambda z: spatial_softmax(z, grid)[0].sum())(logits)
    assert bool(jnp.all(jnp.isfinite(gradient)))
