"""Add keypoints, heat maps and a time line to frames."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Shaped, UInt8

from keycld.drawing.frames import GAP_COLOUR, enlarge
from keycld.drawing.palette import KEYPOINT_COLOURS


def to_pixels(points: Float[np.ndarray, "*any 2"], height: int, width: int) -> Float[np.ndarray, "*any 2"]:
    """Convert image-plane units (x right, y up) to fractional (column, row).

    The origin is the image centre and ±1 are the centres of the outermost pixels of the shorter side:
    column = (width − 1)/2 + x (s − 1)/2 and row = (height − 1)/2 − y (s − 1)/2 with s = min(height, width).
    """
    half = (min(height, width) - 1) / 2.0
    column = (width - 1) / 2.0 + half * points[..., 0]
    row = (height - 1) / 2.0 - half * points[..., 1]
    return np.stack([column, row], axis=-1)


def overlay_keypoints(
    frames: UInt8[np.ndarray, "T H W 3"],
    keypoints: Float[np.ndarray, "T K 2"],
    scale: int = 4,
    trail: int = 0,
    radius: float = 0.05,
    colours: Sequence[tuple[int, int, int]] = KEYPOINT_COLOURS,
) -> UInt8[np.ndarray, "T H2 W2 3"]:
    """Enlarge the frames and put a ringed disc at each keypoint.

    Args:
        frames: uint8 `[T, H, W, 3]`.
        keypoints: `[T, K, 2]` in image-plane units. A keypoint that is not finite is left out.
        scale: enlargement; the discs have smooth edges at the larger size.
        trail: how many earlier positions to show, fading.
        radius: of the discs, in image-plane units.
        colours: of the discs, in turn.
    """
    _, height, width, _ = frames.shape
    canvas = enlarge(frames, scale).copy()
    centres = scale * (to_pixels(keypoints, height, width) + 0.5) - 0.5
    size = max(2.0, radius * scale * min(height, width) / 2.0)
    for t, picture in enumerate(canvas):
        for k in range(keypoints.shape[1]):
            colour = colours[k % len(colours)]
            for age in range(min(trail, t), 0, -1):
                fade = 0.55 * (1.0 - age / (trail + 1.0))
                _disc(picture, centres[t - age, k], 0.4 * size, colour, fade)
            _disc(picture, centres[t, k], size + 0.4 * scale, GAP_COLOUR, 0.85)
            _disc(picture, centres[t, k], size, colour, 1.0)
    return canvas


def overlay_future(
    frame: UInt8[np.ndarray, "H W 3"], keypoints: Float[np.ndarray, "K 2"], future: Float[np.ndarray, "T K 2"]
) -> UInt8[np.ndarray, "H W 3"]:
    """Put a ringed disc at each keypoint, and dots where it will be, smaller and fainter the later.

    Args:
        frame: uint8 `[H, W, 3]`.
        keypoints: `[K, 2]` in image-plane units.
        future: `[T, K, 2]`, of the frames to come; T may be 0.
    """
    picture = overlay_keypoints(frame[None], keypoints[None], scale=1, radius=0.035)[0]
    height, width, _ = frame.shape
    centres, size = to_pixels(future, height, width), 0.0125 * min(height, width)
    for t in range(len(future) - 1, -1, -1):
        nearness = 1.0 - t / len(future)
        for k, centre in enumerate(centres[t]):
            colour = KEYPOINT_COLOURS[k % len(KEYPOINT_COLOURS)]
            _disc(picture, centre, size * (0.5 + 0.5 * nearness), colour, 0.25 + 0.75 * nearness)
    return picture


def _disc(picture: np.ndarray, centre: np.ndarray, radius: float, colour: tuple, opacity: float) -> None:
    """Blend a smooth-edged disc into `picture`, in place and only in a window around it."""
    if not np.all(np.isfinite(centre)):
        return
    height, width, _ = picture.shape
    # Clip before rounding: a diverged roll-out may hold numbers beyond any integer.
    low = np.clip(np.floor(centre - radius - 1.0), 0, (width, height)).astype(int)
    high = np.clip(np.ceil(centre + radius + 2.0), 0, (width, height)).astype(int)
    if np.any(high <= low):
        return
    rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]]
    distance = np.hypot(columns - centre[0], rows - centre[1])
    cover = opacity * np.clip(radius + 0.5 - distance, 0.0, 1.0)[..., None]
    window = picture[low[1] : high[1], low[0] : high[0]]
    window[...] = np.round((1.0 - cover) * window + cover * np.array(colour, float)).astype(np.uint8)


def overlay_heat_maps(
    frames: UInt8[np.ndarray, "T H W 3"],
    heat_maps: Shaped[np.ndarray, "T K rows columns"],
    scale: int = 4,
) -> UInt8[np.ndarray, "T H2 W2 3"]:
    """Dim and enlarge the frames, with each keypoint's heat map as a glow in the keypoint's colour.

    Args:
        frames: uint8 `[T, H, W, 3]`.
        heat_maps: `[T, K, H/stride, W/stride]`, not negative; each is shown relative to its own peak.
        scale: enlargement.
    """
    grey = frames.astype(np.float32).mean(axis=-1, keepdims=True)
    picture = 0.25 * frames + 0.35 * grey
    stride = frames.shape[1] // heat_maps.shape[2]
    for k in range(heat_maps.shape[1]):
        glow = np.repeat(np.repeat(heat_maps[:, k].astype(np.float32), stride, axis=1), stride, axis=2)
        peak = np.maximum(glow.max(axis=(1, 2), keepdims=True), 1e-12)
        cover = np.sqrt(np.nan_to_num(glow / peak))[..., None]
        colour = np.array(KEYPOINT_COLOURS[k % len(KEYPOINT_COLOURS)], np.float32)
        picture = (1.0 - cover) * picture + cover * colour
    return enlarge(np.round(picture).astype(np.uint8), scale)


def overlay_timeline(
    frames: UInt8[np.ndarray, "T H W 3"],
    good: Bool[np.ndarray, "T"],
    height: int = 6,
    colours: tuple[tuple[int, int, int], tuple[int, int, int]] = ((64, 190, 130), (226, 72, 84)),
) -> UInt8[np.ndarray, "T H2 W 3"]:
    """Add a bar below the frames that fills with time: the first colour where `good`, else the second."""
    length, _, width, _ = frames.shape
    column_frame = np.minimum(np.arange(width) * length // width, length - 1)
    shade = np.where(good[column_frame, None], np.array(colours[0]), np.array(colours[1]))
    past = column_frame[None, :] <= np.arange(length)[:, None]
    line = np.where(past[..., None], shade[None], np.array(GAP_COLOUR)[None, None]).astype(np.uint8)
    bar = np.broadcast_to(line[:, None], (length, height, width, 3))
    return np.concatenate([frames, bar], axis=1)
