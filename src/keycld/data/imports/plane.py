"""A plane that the camera sees from the side is mapped to one that it sees from the front."""

import numpy as np
from jaxtyping import Float

from keycld._errors import KeycldError

Plane = tuple[float, float, float, float, float, float, float, float]
"""Pixels (x, y) of four corners of a rectangle in the plane of the motion: top left, top right, bottom right, bottom
left."""


def homography(source: Float[np.ndarray, "4 2"], target: Float[np.ndarray, "4 2"]) -> Float[np.ndarray, "3 3"]:
    """Return the projective map H that takes four points to four points: (x', y', 1) ~ H (x, y, 1)."""
    rows, values = [], []
    for (x, y), (to_x, to_y) in zip(source, target, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -to_x * x, -to_x * y], [0, 0, 0, x, y, 1, -to_y * x, -to_y * y]]
        values += [to_x, to_y]
    return np.append(np.linalg.solve(np.array(rows, float), np.array(values, float)), 1.0).reshape(3, 3)


def plane_filter(plane: Plane, ratio: float, width: int, height: int) -> str:
    """Return the ffmpeg filter that maps a plane to its view from the front, in a picture of the same size.

    The rectangle keeps its middle and its area.

    Args:
        plane: corners of a rectangle in the plane, pixels.
        ratio: width of this rectangle divided by its height; 1 for a square.
        width: of the video, pixels.
        height: of the video, pixels.

    Raises:
        KeycldError: the points are no corners of a rectangle in this order, or the plane is seen so flat that its
            horizon is in the picture.
    """
    points = np.array(plane, float).reshape(4, 2)
    sides = np.roll(points, -1, axis=0) - points
    turns = sides[:, 0] * np.roll(sides[:, 1], -1) - sides[:, 1] * np.roll(sides[:, 0], -1)
    if not (np.all(np.isfinite(points)) and np.all(turns > 0)):
        raise KeycldError(
            "--plane is four corners in the order top left, top right, bottom right, bottom left, pixels, not "
            f"{' '.join(f'{number:g}' for number in plane)}."
        )
    if not 0 < ratio < float("inf"):
        raise KeycldError(f"--plane-ratio is the width of the rectangle divided by its height, above 0, not {ratio}.")
    x, y = points.T
    area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    wide = np.sqrt(area * ratio)
    half = np.array([wide, wide / ratio]) / 2
    target = points.mean(axis=0) + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    matrix = homography(points, target)
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], float)
    mapped = np.concatenate([corners, np.ones((4, 1))], axis=1) @ matrix.T
    if np.any(mapped[:, 2] < 0.1 * float(np.append(points.mean(axis=0), 1) @ matrix[2])):
        raise KeycldError(
            "the plane is seen so flat that its horizon is in the picture: move the camera in front of it."
        )
    numbers = (mapped[:, :2] / mapped[:, 2:]).reshape(-1)
    places = ":".join(f"{name}={number:.4f}" for name, number in zip(_NAMES, numbers, strict=True))
    return f"perspective={places}:sense=destination:interpolation=cubic"


_NAMES = ("x0", "y0", "x1", "y1", "x2", "y2", "x3", "y3")
