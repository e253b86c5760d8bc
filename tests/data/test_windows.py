"""Windows of consecutive frames: where they lie, and which inputs come with them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld import KeycldError
from keycld.data import Resident, Windows


def resident(u):
    """Four trajectories of ten frames, whose every pixel tells trajectory and frame: 10 n + t."""
    number = (10 * np.arange(4)[:, None] + np.arange(10)[None, :]).astype(np.uint8)
    image = np.broadcast_to(number[:, :, None, None, None], (4, 10, 8, 8, 3))
    return Resident(jnp.asarray(image), jnp.asarray(u, jnp.float32), jnp.array(0.1))


def numbers(clip):
    return np.round(np.asarray(clip.frames[..., 0, 0, 0]) * 255).astype(int)


def test_windows_are_contiguous_and_uniform():
    clip = Windows(4000, 7)(resident(np.zeros((4, 0))), jax.random.key(0), jnp.array(5))
    seen = numbers(clip)
    assert clip.frames.shape == (4000, 7, 8, 8, 3) and clip.span == 7 and clip.u.shape == (4000, 0)
    np.testing.assert_array_equal(clip.index, np.broadcast_to(np.arange(7), (4000, 7)))
    np.testing.assert_array_equal(seen, seen[:, :1] + np.arange(7))
    # Four trajectories and the four first frames that leave room: sixteen equally likely windows.
    first, times = np.unique(seen[:, 0], return_counts=True)
    assert set(first) == {10 * n + t for n in range(4) for t in range(4)}
    assert np.all(np.abs(times - 250) < 5 * np.sqrt(250))


def test_the_input_is_cut_to_the_window():
    held = 10.0 * np.arange(4)[:, None, None] + np.arange(10)[None, :, None]
    clip = Windows(16, 3)(resident(held), jax.random.key(1), jnp.array(0))
    np.testing.assert_array_equal(np.asarray(clip.u)[..., 0], numbers(clip))
    constant = Windows(16, 3)(resident(np.arange(4.0)[:, None]), jax.random.key(1), jnp.array(0))
    np.testing.assert_array_equal(np.asarray(constant.u)[:, 0], numbers(constant)[:, 0] // 10)


def test_a_whole_trajectory_is_a_window():
    clip = Windows(8, 10)(resident(np.zeros((4, 0))), jax.random.key(0), jnp.array(0))
    np.testing.assert_array_equal(numbers(clip) % 10, clip.index)


def test_the_step_number_decides_the_windows():
    data, sampler = resident(np.zeros((4, 0))), Windows(32, 4)
    one, same, other = (numbers(sampler(data, jax.random.key(0), jnp.array(step))) for step in (5, 5, 6))
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()


def test_too_short_trajectories_are_refused():
    with pytest.raises(KeycldError, match="have 10 frames but this recipe samples clips of 11"):
        Windows(2, 11).check(resident(np.zeros((4, 0))))
