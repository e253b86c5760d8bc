"""Add the links of a mechanism and the path of its keypoints to frames."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8

from keycld.drawing.overlays import to_pixels

Colour = tuple[int, int, int]


def overlay_links(
    frames: UInt8[np.ndarray, "T H W 3"],
    ends: Float[np.ndarray, "T L 2 2"],
    colours: Sequence[Colour],
    *,
    width: float = 0.02,
    opacity: float = 1.0,
) -> UInt8[np.ndarray, "T H W 3"]:
    """Return frames with a line of round ends for each link.

    Args:
        frames: already of the size at which they are shown.
        ends: both ends of each link in each frame, image-plane units; a link with an end that is not finite is left
            out.
        colours: of the links.
        width: half of the width of a line, image-plane units.
        opacity: of the lines.
    """
    _, height, columns, _ = frames.shape
    canvas, radius = frames.copy(), max(1.0, width * min(height, columns) / 2)
    pixels = to_pixels(ends, height, columns)
    for picture, links in zip(canvas, pixels, strict=True):
        for (a, b), colour in zip(links, colours, strict=True):
            _capsule(picture, a, b, radius, colour, opacity)
    return canvas


def overlay_paths(
    frames: UInt8[np.ndarray, "T H W 3"],
    paths: Float[np.ndarray, "T K 2"],
    colours: Sequence[Colour],
    *,
    ahead: int,
    radius: float = 0.012,
) -> UInt8[np.ndarray, "T H W 3"]:
    """Return frames with the positions of each keypoint in the next `ahead` frames, which fade with time.

    Args:
        frames: already of the size at which they are shown.
        paths: positions in all frames, image-plane units; those that are not finite are left out.
        colours: of the keypoints.
        ahead: number of later frames.
        radius: of the dots, image-plane units.
    """
    count, height, width, _ = frames.shape
    canvas, size = frames.copy(), max(1.0, radius * min(height, width) / 2)
    pixels = to_pixels(paths, height, width)
    for t, picture in enumerate(canvas):
        for later in range(min(count - 1, t + ahead), t, -1):
            fade = 0.9 * (1 - (later - t) / (ahead + 1))
            for place, colour in zip(pixels[later], colours, strict=True):
                _capsule(picture, place, place, size, colour, fade)
    return canvas


def _capsule(picture: np.ndarray, a: np.ndarray, b: np.ndarray, radius: float, colour: Colour, opacity: float) -> None:
    """Blend all pixels up to a radius from the line between a and b into `picture`, in place."""
    if not (np.all(np.isfinite(a)) and np.all(np.isfinite(b))):
        return
    height, width, _ = picture.shape
    # Clip before rounding: a diverged roll-out may hold numbers beyond any integer.
    low = np.clip(np.floor(np.minimum(a, b) - radius - 1), 0, (width, height)).astype(int)
    high = np.clip(np.ceil(np.maximum(a, b) + radius + 2), 0, (width, height)).astype(int)
    if np.any(high <= low):
        return
    rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]]
    along = b - a
    share = ((columns - a[0]) * along[0] + (rows - a[1]) * along[1]) / max(float(along @ along), 1e-9)
    share = np.clip(share, 0, 1)
    distance = np.hypot(columns - a[0] - share * along[0], rows - a[1] - share * along[1])
    cover = opacity * np.clip(radius + 0.5 - distance, 0.0, 1.0)[..., None]
    window = picture[low[1] : high[1], low[0] : high[0]]
    window[...] = np.round((1 - cover) * window + cover * np.array(colour, float)).astype(np.uint8)
