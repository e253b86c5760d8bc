import numpy as np

from keycld.drawing import (
    KEYPOINT_COLOURS,
    overlay_heat_maps,
    overlay_keypoints,
    overlay_timeline,
    to_pixels,
)
from keycld.vision import image_grid


def test_the_image_plane_is_that_of_the_models():
    """`vision` gives the positions of all pixel centres; `to_pixels` gives back their numbers."""
    for height, width in ((64, 64), (16, 24), (30, 20)):
        pixels = to_pixels(np.asarray(image_grid(height, width), np.float64), height, width)
        rows, columns = np.mgrid[:height, :width]
        np.testing.assert_allclose(pixels, np.stack([columns, rows], axis=-1), atol=1e-4)


def test_a_disc_is_at_its_keypoint():
    frames = np.zeros((1, 32, 32, 3), np.uint8)
    point = np.array([0.4, -0.2])
    shown = overlay_keypoints(frames, point[None, None], scale=4)[0]
    disc = np.all(np.abs(shown.astype(int) - np.array(KEYPOINT_COLOURS[0])) < 3, axis=-1)
    rows, columns = np.nonzero(disc)
    expected = 4 * (to_pixels(point, 32, 32) + 0.5) - 0.5
    np.testing.assert_allclose([columns.mean(), rows.mean()], expected, atol=0.3)


def test_a_trail_fades_and_the_frames_are_not_changed():
    frames = np.full((5, 16, 16, 3), 20, np.uint8)
    before = frames.copy()
    path = np.stack([np.linspace(-0.8, 0.8, 5), np.zeros(5)], axis=-1)[:, None]
    plain, trailed = overlay_keypoints(frames, path), overlay_keypoints(frames, path, trail=4)
    np.testing.assert_array_equal(frames, before)
    np.testing.assert_array_equal(plain[0], trailed[0])
    old, older = (to_pixels(path[k, 0], 16, 16) for k in (3, 0))
    strength = [
        int(np.abs(trailed[4, int(4 * p[1]) + 2, int(4 * p[0]) + 2].astype(int) - 20).max()) for p in (old, older)
    ]
    assert strength[0] > strength[1] > 0


def test_keypoints_outside_or_not_finite_change_nothing():
    frames = np.zeros((4, 8, 8, 3), np.uint8)
    path = np.array([[np.nan, 0.0], [np.inf, 0.0], [1e30, -1e30], [5.0, 5.0]])[:, None]
    assert overlay_keypoints(frames, path, trail=3).max() == 0


def test_heat_maps_glow_at_their_peak_also_at_half_resolution():
    frames = np.full((1, 16, 16, 3), 100, np.uint8)
    maps = np.zeros((1, 2, 8, 8))
    maps[0, 0, 1, 6], maps[0, 1, 7, 0] = 0.5, 0.001
    shown = overlay_heat_maps(frames, maps, scale=1)[0]
    np.testing.assert_array_equal(shown[2:4, 12:14], np.broadcast_to(KEYPOINT_COLOURS[0], (2, 2, 3)))
    np.testing.assert_array_equal(shown[14:16, 0:2], np.broadcast_to(KEYPOINT_COLOURS[1], (2, 2, 3)))
    assert shown[8, 8].max() < 100


def test_the_time_line_fills_and_changes_colour():
    frames = np.zeros((4, 2, 8, 3), np.uint8)
    bar = overlay_timeline(frames, np.array([True, True, False, False]), height=3, colours=((1, 2, 3), (9, 8, 7)))
    assert bar.shape == (4, 5, 8, 3)
    np.testing.assert_array_equal(bar[3, 2, :, 0], [1, 1, 1, 1, 9, 9, 9, 9])
    assert bar[0, 2, 1, 0] == 1 and bar[0, 2, 2, 0] not in (1, 9)
