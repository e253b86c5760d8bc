"""A slanted plane that is mapped to its view from the front keeps its lengths."""

import h5py
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares

from keycld._errors import KeycldError
from keycld.data import before_test, import_clip, open_data
from keycld.data.imports.plane import homography, plane_filter
from keycld.drawing import save_movie

SQUARE = np.array([[40.0, 20.0], [120.0, 20.0], [120.0, 100.0], [40.0, 100.0]])
SEEN = np.array([[50.0, 16.0], [116.0, 32.0], [112.0, 92.0], [46.0, 110.0]])
RADIUS = 40.0


@pytest.fixture(scope="module")
def slanted(tmp_path_factory):
    """A ball that swings 40 pixels from a pivot in front of a square of 80, seen from the side."""
    row, column = np.mgrid[:120, :160]
    angle = 1.3 * np.cos(2 * np.pi * np.arange(72) / 36)
    x, y = 80 + RADIUS * np.sin(angle), 44 + RADIUS * np.cos(angle)
    back = np.linalg.inv(homography(SQUARE, SEEN))
    u, v, w = np.einsum("ij,jrc->irc", back, np.stack([column, row, np.ones_like(row)]).astype(float))
    frames = []
    for ball in np.stack([x, y], axis=1):
        front = 200 * np.clip(7.5 - np.hypot(column - ball[0], row - ball[1]), 0, 1)
        frames.append(30 + map_coordinates(front, [v / w, u / w], order=1))
    path = tmp_path_factory.mktemp("plane") / "slanted.mp4"
    save_movie(path, np.repeat(np.round(frames).astype(np.uint8)[..., None], 3, axis=-1), fps=25.0, scale=1)
    return path


def circle(folder):
    """Return the radius of the ball's circle and the deviation from it, pixels of the video."""
    data = open_data(folder)
    image = before_test(data).image.reshape(-1, 128, 128, 3)[..., 0].astype(float)
    weight = np.clip(image - np.median(image, axis=0) - 20, 0, None)
    rows, columns = np.mgrid[:128, :128]
    centre = np.stack([(weight * axis).sum((1, 2)) / weight.sum((1, 2)) for axis in (columns, rows)], axis=1)
    with h5py.File(folder / "train.h5") as file:
        scale = file.attrs["crop"][2] / 128
    fit = least_squares(lambda p: np.hypot(*(centre * scale - p[:2]).T) - p[2], [64 * scale, 40 * scale, 40])
    return fit.x[2], np.sqrt(np.mean(fit.fun**2))


def test_lengths_of_a_slanted_view(slanted, tmp_path):
    """The length in the plane is right within 1 %, and wrong by several per cent without it."""
    import_clip(slanted, tmp_path / "front", constraints=None, size=128, plane=tuple(SEEN.reshape(-1).tolist()))
    import_clip(slanted, tmp_path / "side", constraints=None, size=128)
    x, y = SEEN.T
    side = np.sqrt(0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    radius, off = circle(tmp_path / "front")
    assert radius == pytest.approx(RADIUS * side / 80, rel=0.01) and off < 0.005 * radius
    assert abs(circle(tmp_path / "side")[0] / (RADIUS * side / 80) - 1) > 0.03


def test_a_ratio_without_a_plane(slanted, tmp_path):
    with pytest.raises(KeycldError, match="--plane-ratio 2 is the shape of a --plane: give its four corners too"):
        import_clip(slanted, tmp_path / "wide", constraints=None, size=128, plane_ratio=2.0)
    assert not (tmp_path / "wide").exists()


def test_a_plane_that_cannot_be():
    with pytest.raises(KeycldError, match="four corners in the order"):
        plane_filter((0.0, 0.0, 10.0, 10.0, 10.0, 0.0, 0.0, 10.0), 1.0, 100, 100)
    with pytest.raises(KeycldError, match="horizon is in the picture"):
        plane_filter((45.0, 50.0, 55.0, 50.0, 90.0, 60.0, 10.0, 60.0), 1.0, 100, 100)
    with pytest.raises(KeycldError, match="above 0, not -1"):
        plane_filter(tuple(SQUARE.reshape(-1).tolist()), -1.0, 160, 120)
