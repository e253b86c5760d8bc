"""What is behind the parts, from frames that show them most of the time."""

import numpy as np
import pytest

from keycld.vision import still_background

SIZE = 48
ROWS, COLUMNS = np.mgrid[:SIZE, :SIZE]
GROUND = np.stack([0.5 + 0.004 * ROWS, 0.6 - 0.003 * COLUMNS, np.full((SIZE, SIZE), 0.7)], axis=-1)
WITH_POST = GROUND.copy()
WITH_POST[:, 30:33] = [0.3, 0.4, 0.2]
CART, ROD = np.array([0.3, 0.1, 0.2]), np.array([0.9, 0.9, 0.2])


def recorded(shown, ground=GROUND, colour=CART, frames=150):
    """Frames in which `shown(t)`, a mask, has the colour of the part."""
    random = np.random.default_rng(0)
    pictures = np.repeat(ground[None], frames, axis=0)
    for t in range(frames):
        pictures[t][shown(t)] = colour
    pictures = pictures + 0.008 * random.standard_normal(pictures.shape)
    return np.round(255 * np.clip(pictures, 0, 1)).astype(np.uint8)


def cart(t):
    middle = 24 + 11 * np.exp(-0.003 * t) * np.cos(0.2 * t)
    return (np.abs(COLUMNS - middle) < 9) & (np.abs(ROWS - 20) < 4)


@pytest.mark.parametrize("ground", [GROUND, WITH_POST])
def test_a_cart_longer_than_its_swing_is_not_in_it(ground):
    frames = recorded(cart, ground)
    covered = np.mean([cart(t) for t in range(150)], axis=0)
    most = (covered > 0.55) & (covered < 0.9)
    assert most.sum() > 50
    # The median frame shows it there.
    assert np.abs(np.median(frames, axis=0)[most] / 255.0 - ground[most]).mean() > 0.1
    assert np.abs(still_background(frames) - ground)[covered < 0.9].max() < 0.05


def test_the_middle_of_a_cart_that_is_always_there_is_not_in_it():
    def shown(t):
        return (np.abs(COLUMNS - 22 - 5 * np.cos(0.2 * t)) < 10) & (np.abs(ROWS - 20) < 5)

    covered = np.mean([shown(t) for t in range(150)], axis=0)
    assert np.sum(covered == 1) > 80
    assert np.abs(still_background(recorded(shown)) - GROUND).max() < 0.05


def test_a_nail_in_the_colour_of_the_cart_stays_in_it():
    ground = GROUND.copy()
    ground[10:15, 20:25] = CART
    found = still_background(recorded(cart, ground))
    np.testing.assert_allclose(found[10:15, 20:25], ground[10:15, 20:25], atol=0.02)


def test_a_box_whose_edges_tremble_with_the_camera_stays_in_it():
    """To both sides by a pixel, at random, beside a ball that moves."""
    frames = recorded(lambda t: np.hypot(ROWS - 36, COLUMNS - 24 - 15 * np.cos(0.2 * t)) < 4)
    for frame, shift in zip(frames, np.random.default_rng(1).integers(0, 2, (len(frames), 2)), strict=True):
        top, left = 8 + shift
        frame[top : top + 8, left : left + 10] = np.round(255 * ROD)
    np.testing.assert_allclose(still_background(frames)[9:16, 9:18], np.broadcast_to(ROD, (7, 9, 3)), atol=0.02)


def test_the_end_of_a_rod_at_its_pivot_does_not_grow():
    ground = np.where((np.hypot(ROWS - 20, COLUMNS - 24) < 3)[..., None], ROD, GROUND)

    def shown(t):
        angle = 1.2 * np.cos(0.15 * t)
        along = np.clip((COLUMNS - 24) * np.sin(angle) + (ROWS - 20) * np.cos(angle), 0, 18)
        return np.hypot(COLUMNS - 24 - along * np.sin(angle), ROWS - 20 - along * np.cos(angle)) < 2

    found = still_background(recorded(shown, ground, ROD))
    always = np.mean([shown(t) for t in range(150)], axis=0) > 0.9
    assert np.abs(found - ground)[~always].max() < 0.05


@pytest.mark.parametrize("level", [0, 255])
def test_frames_without_motion_are_their_own_background(level):
    frames = np.full((5, 8, 8, 3), level, np.uint8)
    np.testing.assert_array_equal(still_background(frames), frames[0] / 255.0)


def test_two_frames_that_differ_everywhere():
    frames = np.stack([np.zeros((8, 8, 3), np.uint8), np.full((8, 8, 3), 200, np.uint8)])
    assert np.isfinite(still_background(frames)).all()
