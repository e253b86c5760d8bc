"""Soft discs fitted to frames: centres, radii and colours as they were drawn."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.systems.discs import BACKGROUND, soft_discs
from keycld.vision import fit_discs, image_grid

BEHIND = jnp.broadcast_to(jnp.round(255 * jnp.asarray(BACKGROUND)) / 255, (32, 32, 3))
PIXEL = 2 / 31
FIT = eqx.filter_jit(fit_discs)


def drawn(places, radii, colours):
    """Return frames of discs at `[n, K, 2]`, pixels right and up of the middle, in 256 values."""
    canvas = jnp.array([0.0, 31.0])
    frames = [soft_discs(15.5 + jnp.asarray(p * [1, -1], jnp.float32), radii, colours, canvas) for p in places]
    return jnp.round(255 * jnp.stack(frames)) / 255


def rod(length, count=12):
    """Return two discs at the ends of a rod that turns."""
    turned = np.linspace(0.1, 3.0, count)
    along = length / 2 * np.stack([np.cos(turned), np.sin(turned)], axis=-1)
    return np.array([1.3, -2.2]) + np.stack([along, -along], axis=1)


@pytest.mark.parametrize(("length", "front"), [(2.5, 0), (2.5, 1), (4.5, 0), (9.0, 1)])
def test_discs_that_overlap_are_found_to_thousandths_of_a_pixel(length, front):
    """Guesses are 0.2 pixels off, along the rod, as a network's keypoints and centres of light are.

    Either disc may be the one in front.
    """
    places = rod(length)
    radii, colours = jnp.array([1.8, 2.2]), jnp.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])
    depth = np.array([front, 1 - front])
    frames = drawn(places[:, depth], radii[depth], colours[depth])
    middle = places.mean(axis=1, keepdims=True)
    guess = middle + (1 + 0.4 / length) * (places - middle)
    found = FIT(frames, BEHIND, jnp.asarray(guess * PIXEL, jnp.float32))
    off = np.linalg.norm(np.asarray(found.centres) / PIXEL - places, axis=-1)
    assert np.median(off) < 0.002 and off.max() < 0.006
    np.testing.assert_allclose(np.asarray(found.radii) / PIXEL, np.broadcast_to(radii, (12, 2)), rtol=0.005)
    np.testing.assert_allclose(np.median(found.colours, axis=0), colours, atol=0.02)
    assert np.max(found.left) < 0.02


def test_light_is_that_of_each_disc_alone():
    """Also where they overlap, and in per cent of a white picture."""
    radii, colours = jnp.array([1.8, 2.2]), jnp.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])
    places = rod(4.0)
    light = FIT(drawn(places, radii, colours), BEHIND, jnp.asarray(places * PIXEL, jnp.float32)).light
    for k in range(2):
        alone = drawn(places[:1, k : k + 1], radii[k : k + 1], colours[k : k + 1])[0] - BEHIND
        wanted = np.sum(np.asarray(alone), axis=(0, 1)) * 100 / 1024
        np.testing.assert_allclose(np.asarray(light[:, k]), np.broadcast_to(wanted, (12, 3)), atol=0.01)


def test_what_is_no_disc_leaves_light():
    """A square of one colour, and a disc with a stick."""
    grid = image_grid(32, 32)
    square = jnp.all(jnp.abs(grid - 0.1) < 0.2, axis=-1)
    stick = (jnp.linalg.norm(grid, axis=-1) < 0.2) | ((jnp.abs(grid[..., 0]) < 0.04) & (grid[..., 1] > 0))
    frames = BEHIND[None] + 0.5 * jnp.stack([square, stick])[..., None]
    left = FIT(frames, BEHIND, jnp.array([[[0.1, 0.1]], [[0.0, 0.0]]])).left
    assert np.min(left) > 0.06


def test_an_empty_frame_leaves_keypoints_where_they_are():
    found = FIT(BEHIND[None], BEHIND, jnp.array([[[0.2, -0.3], [0.1, 0.4]]]))
    assert np.all(np.isfinite(found.centres)) and np.all(np.isfinite(found.light)) and np.all(np.isfinite(found.left))
    np.testing.assert_allclose(found.centres, [[[0.2, -0.3], [0.1, 0.4]]], atol=1e-3)
    np.testing.assert_allclose(found.light, 0, atol=1e-3)
