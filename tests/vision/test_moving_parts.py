"""Parts that move, told apart by their colours."""

import numpy as np

from keycld.vision import moving_parts

SIDE = 48


def scene(parts, shade=0.02):
    """Return frames of discs over a ground with noise: (x, y, radius, colour) each, in image-plane units."""
    random = np.random.default_rng(0)
    step = 2 / (SIDE - 1)
    rows, columns = np.mgrid[:SIDE, :SIDE]
    x, y = columns * step - 1, 1 - rows * step
    frames = np.full((60, SIDE, SIDE, 3), 0.55)
    for track, radius, colour in parts:
        far = np.hypot(x - track[:, 0, None, None], y - track[:, 1, None, None])
        cover = np.clip((radius - far) / step + 0.5, 0, 1)[..., None]
        frames = (1 - cover) * frames + cover * np.array(colour)
    return np.round(255 * np.clip(frames + shade * random.standard_normal(frames.shape), 0, 1)).astype(np.uint8)


PHASE = 2 * np.pi * np.arange(60) / 40
ONE = 0.6 * np.stack([np.cos(PHASE), np.sin(PHASE)], axis=1)
OTHER = np.stack([0.5 * np.sin(2 * PHASE), 0.1 * np.cos(PHASE)], axis=1)


def error(part, track):
    return np.sqrt(np.mean(np.sum((part.track - track)[part.seen] ** 2, axis=1)))


def test_two_colours_are_two_parts_within_a_fifth_of_a_pixel():
    parts = moving_parts(scene([(ONE, 0.2, (0.9, 0.2, 0.1)), (OTHER, 0.15, (0.1, 0.2, 0.9))]))
    assert len(parts) == 2 and all(part.changes < 0.1 for part in parts)
    assert error(parts[0], ONE) < 0.2 * 2 / (SIDE - 1) and error(parts[1], OTHER) < 0.2 * 2 / (SIDE - 1)


def test_two_spots_of_one_colour_are_followed_past_each_other():
    parts = moving_parts(scene([(ONE, 0.12, (0.1, 0.1, 0.1)), (-ONE / 2, 0.12, (0.1, 0.1, 0.1))]))
    assert len(parts) == 2
    assert min(error(part, ONE) for part in parts) < 0.02 and min(error(part, -ONE / 2) for part in parts) < 0.02


def test_a_small_spot_that_vanishes_for_a_while_comes_back_as_itself():
    """Twelve frames, in which one of two equal spots of some ten pixels is covered and goes half around."""
    gone = ONE.copy()
    gone[20:32] = 9.0
    parts = moving_parts(scene([(gone, 0.08, (0.1, 0.1, 0.1)), (-ONE / 2, 0.08, (0.1, 0.1, 0.1))]))
    one, other = sorted(parts, key=lambda part: error(part, ONE))
    assert error(one, ONE) < 0.02 and error(other, -ONE / 2) < 0.02
    assert not one.seen[20:32].any() and one.seen.sum() > 40 and other.seen.sum() > 50


def test_nothing_moves():
    assert moving_parts(scene([])) == []
