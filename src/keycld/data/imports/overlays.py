"""A clock or a time stamp in the picture changes without moving: it is found, and painted over."""

import numpy as np
from jaxtyping import Bool

Box = tuple[float, float, float, float]
"""Left, top, right and bottom, as shares of width and height."""

# Cells of the picture between the signs of one clock.
_APART = 3
# Diagonal of a clock as a share of that of what moves, how far its changes wander as a share of its sides, and in which
# share of the frames some sign is not as usual.
_SMALL, _STAYS, _OFTEN = 0.25, 0.1, 0.7
# With more of such places they are no clocks.
_MOST = 4


def overlays(differs: Bool[np.ndarray, "T h w"], moves: Bool[np.ndarray, "h w"]) -> list[Box]:
    """Return places that change without moving, next to something large that moves.

    A place is a group of pixels apart from all others, a quarter as large as the largest one or smaller. The middle of
    the pixels that differ wanders through most of the place where a part moves, however little: a sinusoidal motion has
    a standard deviation of 0.35 of its extent. On a clock it stays, because all signs are there at all times. That also
    tells it from places that a part visits for a while.

    Args:
        differs: which pixels are not as usual in each frame.
        moves: which pixels are ever so.
    """
    from scipy import ndimage

    labels = np.empty(moves.shape, np.int32)
    ndimage.label(ndimage.binary_dilation(moves, iterations=_APART), output=labels)
    groups = ndimage.find_objects(np.where(moves, labels, 0))
    sizes = [np.hypot(*(side.stop - side.start for side in group)) for group in groups]
    found = []
    for number, (group, size) in enumerate(zip(groups, sizes, strict=True), 1):
        if size > _SMALL * max(sizes):
            continue
        pixels = differs[(slice(None), *group)] & (labels[group] == number)
        pixels = pixels[np.any(pixels, axis=(1, 2))]
        if len(pixels) < _OFTEN * len(differs):
            continue
        places = np.array([np.mean(np.nonzero(frame), axis=1) for frame in pixels])
        if np.all(np.std(places, axis=0) < _STAYS * np.array(pixels.shape[1:])):
            (top, bottom), (left, right) = ((side.start, side.stop) for side in group)
            h, w = moves.shape
            found.append((left / w, top / h, right / w, bottom / h))
    return found if len(found) <= _MOST else []


def pixels_of(box: Box, width: int, height: int) -> tuple[int, int, int, int]:
    """Return left, top, width and height of a place and a margin around it, pixels inside of the picture."""
    margin = max(2, round(0.01 * max(width, height)))
    left, top = max(1, round(box[0] * width) - margin), max(1, round(box[1] * height) - margin)
    right, bottom = min(width - 1, round(box[2] * width) + margin), min(height - 1, round(box[3] * height) + margin)
    return left, top, right - left, bottom - top


def painted_over(places: list[tuple[int, int, int, int]]) -> str:
    """Return the ffmpeg filter that fills these places, pixels, with what is around them."""
    return ",".join(f"delogo=x={left}:y={top}:w={width}:h={height}" for left, top, width, height in places)
