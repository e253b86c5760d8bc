import numpy as np
import pytest

from keycld import KeycldError
from keycld.drawing import as_uint8, enlarge, labelled_sheet, sheet, side_by_side
from keycld.drawing.frames import GAP_COLOUR, text_strip


def stack(length, height=4, width=5, value=7):
    return np.full((length, height, width, 3), value, np.uint8)


def test_floats_are_rounded_and_nan_is_black():
    frame = np.array([[[0.0, 1.0, 0.5]], [[np.nan, 2.0, -1.0]], [[np.inf, -np.inf, 0.2]]])
    np.testing.assert_array_equal(as_uint8(frame), [[[0, 255, 128]], [[0, 255, 0]], [[255, 0, 51]]])
    assert as_uint8(stack(1)).dtype == np.uint8


def test_every_level_survives_conversion_to_float_and_back():
    levels = np.arange(256, dtype=np.uint8).reshape(1, 256, 1)
    np.testing.assert_array_equal(as_uint8(levels / np.float32(255)), levels)


def test_enlarging_keeps_pixels_square():
    frames = np.arange(2 * 2 * 3 * 3, dtype=np.uint8).reshape(2, 2, 3, 3)
    large = enlarge(frames, 3)
    assert large.shape == (2, 6, 9, 3)
    np.testing.assert_array_equal(large[:, 1::3, 1::3], frames)
    np.testing.assert_array_equal(large[:, 0:3, 0:3], np.broadcast_to(frames[:, :1, :1], (2, 3, 3, 3)))


def test_a_shorter_stack_repeats_its_last_frame():
    long, short = stack(3), np.concatenate([stack(1, value=1), stack(1, value=9)])
    both = side_by_side([long, short], gap=2)
    assert both.shape == (3, 4, 5 + 2 + 5, 3)
    assert both[2, 0, -1, 0] == 9 and both[0, 0, -1, 0] == 1
    np.testing.assert_array_equal(both[0, 0, 5], GAP_COLOUR)


def test_labels_are_above_their_panels():
    both = side_by_side([stack(1, width=80), stack(1, width=80)], ["truth", "prediction"], gap=0)
    strip = both[0, : both.shape[1] - 4]
    assert strip.shape[0] > 10
    assert strip[:, :80].max() > 200 and strip[:, 80:].max() > 200
    assert not np.array_equal(text_strip("truth", 80), text_strip("prediction", 80))


def test_a_sheet_shows_every_sixth_frame():
    frames = np.stack([np.full((4, 4, 3), k, np.uint8) for k in range(50)])
    picture = sheet([frames, frames + 100], every=6, gap=0)
    assert picture.shape == (8, 9 * 4, 3)
    np.testing.assert_array_equal(picture[0, ::4, 0], np.arange(0, 50, 6))
    np.testing.assert_array_equal(picture[4, ::4, 0], 100 + np.arange(0, 50, 6))


def test_a_labelled_sheet_has_heads_above_and_labels_left_of_its_frames():
    rows = [np.stack([np.full((16, 20, 3), 10 * n + k, np.uint8) for k in range(3)]) for n in range(2)]
    picture = labelled_sheet(rows, ["truth", "model"], ["0", "4", "8"], scale=2, gap=2)
    frames = picture[-(2 * 32 + 2) :, -(3 * 40 + 2 * 2) :]
    np.testing.assert_array_equal(frames[[0, 34]][:, [0, 42, 84], 0], [[0, 1, 2], [10, 11, 12]])
    above, left = picture[: -frames.shape[0], -frames.shape[1] :], picture[-frames.shape[0] :, : -frames.shape[1]]
    assert all(above[:, 42 * k : 42 * k + 40].max() > 200 for k in range(3))
    assert left[:32].max() > 200 and left[34:].max() > 200
    with pytest.raises(KeycldError, match="2 rows and 3 columns needs as many labels and heads; got 2 and 1"):
        labelled_sheet(rows, ["truth", "model"], ["0"])


def test_what_does_not_fit_is_named():
    with pytest.raises(KeycldError, match=r"equal heights; got \[4, 6\]"):
        side_by_side([stack(1), stack(1, height=6)])
    with pytest.raises(KeycldError, match="2 panels need as many labels; got 1"):
        side_by_side([stack(1), stack(1)], ["one"])
    with pytest.raises(KeycldError, match="one shape"):
        sheet([stack(1), stack(2)])
