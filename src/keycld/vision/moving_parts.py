"""Tracks of the parts that move in a video, without a network: what differs from the background, by colour."""

import dataclasses
import itertools
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from keycld.vision.still_background import still_background

# A pixel moves if a colour differs from the background by so much, of 1, and by so many standard deviations.
_DIFFERS, _NOISES = 0.08, 6.0
# Colours of parts are further apart than this, and than so many deviations within a part.
_APART, _SPREADS = 0.18, 2.5
_MOST_COLOURS = 4
# A part is seen in this share of the frames, and has this share of the pixels that move.
_SEEN, _SHARE = 0.85, 0.02
# The middle of a part is where it is thicker than this share of its largest thickness: a ball, not the rod that holds
# it.
_THICK = 0.5
# Parts of one colour are told apart if so many frames show the same number of them.
_COUNTED = 0.7
_MOST_ALIKE = 3
# A part that is partly covered shows less than this share of its usual area.
_COVERED = 0.75


@dataclasses.dataclass(frozen=True)
class Part:
    """A part that moves, as a point.

    Attributes:
        track: its middle in each frame `[T, 2]`, image-plane units; between frames in which it is seen where it is not.
        seen: whether it is seen whole `[T]`.
        colour: mean colour, 0 to 1.
        area: median share of what moves, in pixels.
        changes: how far its length varies: deviation of the longer radius of gyration, as a share. Large where the
            track is not that of one rigid part.
    """

    track: Float[np.ndarray, "T 2"]
    seen: Bool[np.ndarray, "T"]
    colour: tuple[float, float, float]
    area: float
    changes: float


def moving_parts(frames: UInt8[np.ndarray, "T H W 3"]) -> list[Part]:
    """Return the parts that move, largest first.

    Pixels that differ from the background are grouped by colour. The pixels of a colour are one part, or several if
    most frames show as many spots of it. Parts of one colour that touch are one part here, which changes its shape.

    Args:
        frames: of a camera at rest, one after another.
    """
    pictures = frames.astype(np.float32) / 255.0
    background = still_background(frames)
    noise = np.median(np.abs(np.diff(pictures[:60], axis=0))) / 0.67 / np.sqrt(2)
    least = max(_DIFFERS, min(_NOISES * float(noise), 0.16))
    off = np.max(np.abs(pictures - background[None]), axis=-1)
    moves = off > least
    colours = _colours(pictures, moves, off)
    if len(colours):
        colours = _unmixed(colours, np.mean(background[moves.any(axis=0)], axis=0))
    if not len(colours):
        return []
    far = np.stack([np.linalg.norm(pictures - colour[None, None, None], axis=-1) for colour in colours])
    nearest = np.argmin(far, axis=0)
    weight = np.clip(off / np.quantile(off[moves], 0.5), 0, 1)
    total = float(np.median(np.sum(weight * moves, axis=(1, 2))))
    found = []
    for k, colour in enumerate(colours):
        found += _spots(moves & (nearest == k), weight, colour, total)
    return sorted((part for part in found if part.area >= _SHARE), key=lambda part: -part.area)


def _unmixed(colours: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Return the colours without those that are mixtures of two others or the background, as borders are."""
    kept = []
    for k, colour in enumerate(colours):
        others = [background, *np.delete(colours, k, axis=0)]
        if not any(_between(colour, a, b) for a, b in itertools.combinations(others, 2)):
            kept.append(colour)
    return np.array(kept)


def _between(colour: np.ndarray, one: np.ndarray, other: np.ndarray) -> bool:
    way = other - one
    share = float((colour - one) @ way / max(float(way @ way), 1e-9))
    return 0.15 < share < 0.85 and bool(np.linalg.norm(colour - one - share * way) < 0.6 * _APART)


def _colours(pictures: np.ndarray, moves: np.ndarray, off: np.ndarray) -> Float[np.ndarray, "k 3"]:
    """Return the colours of what moves: as many means as are well apart (k-means from the furthest points)."""
    # Borders are mixtures with the background, so the pixels count that differ most from it.
    some = pictures[moves & (off >= np.quantile(off[moves], 0.35))] if moves.any() else np.zeros((0, 3))
    if len(some) < 50:
        return np.zeros((0, 3))
    some = some[:: max(1, len(some) // 20_000)].astype(float)
    best = np.mean(some, axis=0, keepdims=True)
    for count in range(2, _MOST_COLOURS + 1):
        centres = [np.median(some, axis=0)]
        for _ in range(count - 1):
            far = np.min([np.linalg.norm(some - centre, axis=1) for centre in centres], axis=0)
            centres.append(some[np.argsort(far)[int(0.98 * len(far))]])
        means, spreads = _means(some, np.array(centres))
        gaps = np.linalg.norm(means[:, None] - means[None], axis=-1) + 10 * np.eye(count)
        needed = np.maximum(_APART, _SPREADS * np.maximum(spreads[:, None], spreads[None]))
        if not np.all(gaps > needed):
            break
        best = means
    return best


def _means(points: np.ndarray, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the means of groups of points, by Lloyd's iteration, and the median deviation in each."""
    for _ in range(20):
        owner = np.argmin([np.linalg.norm(points - centre, axis=1) for centre in centres], axis=0)
        centres = np.array(
            [np.median(points[owner == k], axis=0) if np.any(owner == k) else c for k, c in enumerate(centres)]
        )
    spreads = [
        float(np.median(np.linalg.norm(points[owner == k] - c, axis=1))) if np.any(owner == k) else 9.0
        for k, c in enumerate(centres)
    ]
    return centres, np.array(spreads)


def _spots(mask: Bool[np.ndarray, "T H W"], weight: np.ndarray, colour: np.ndarray, total: float) -> list[Part]:
    """Return the parts of one colour: as many as most frames show."""
    from scipy import ndimage

    depths = np.array([ndimage.distance_transform_edt(frame) for frame in mask])
    largest = depths.max(axis=(1, 2))
    if np.mean(largest > 0) < _SEEN:
        return []
    thick = depths > _THICK * np.median(largest[largest > 0])
    frames = [_components(core, whole, share) for core, whole, share in zip(thick, mask, weight, strict=True)]
    counts = np.array([len(each) for each in frames])
    count = int(np.argmax(np.bincount(counts)))
    if not (1 <= count <= _MOST_ALIKE and np.mean(counts == count) >= _COUNTED):
        count = 1
        frames = [[_measured(core, share)] if core.any() else [] for core, share in zip(mask, weight, strict=True)]
    places = _followed(frames, count)
    height, width = mask.shape[1:]
    found = []
    for k in range(count):
        row, column, area, long = places[:, k].T
        usual = float(np.nanmedian(area))
        seen = np.nan_to_num(area, nan=0.0) > _COVERED * usual
        if np.mean(seen) < 0.5:
            continue
        half = (min(height, width) - 1) / 2
        track = np.stack([(column - (width - 1) / 2) / half, ((height - 1) / 2 - row) / half], axis=1)
        at = np.arange(len(track))
        track = np.stack([np.interp(at, at[seen], values[seen]) for values in track.T], axis=1)
        middle = float(np.median(long[seen]))
        changes = float(np.median(np.abs(long[seen] - middle))) / 0.67 / max(middle, 0.5)
        hue = (float(colour[0]), float(colour[1]), float(colour[2]))
        found.append(Part(track, seen, hue, usual / max(total, 1.0), changes))
    return found


def _components(core: np.ndarray, whole: np.ndarray, weight: np.ndarray) -> list[np.ndarray]:
    """Return row, column, area and longer radius of gyration of each spot of a frame: its thick middle with its rim."""
    from scipy import ndimage

    labels, count = _labelled(core)
    pieces, _ = _labelled(whole)
    sizes = np.bincount(labels.reshape(-1))[1:]
    found = []
    for k in range(1, count + 1):
        middle = labels == k
        if sizes[k - 1] >= 0.35 * sizes.max():
            # With the rim, of which a spot of four pixels has twice as many.
            near = ndimage.binary_dilation(middle, np.ones((3, 3)))
            found.append(_measured(near & (pieces == pieces[middle][0]), weight))
    return found


def _labelled(mask: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the number of the spot of each pixel, 0 outside of them, and how many there are."""
    from scipy import ndimage

    found: Any = ndimage.label(mask, np.ones((3, 3)))
    return found


def _measured(spot: np.ndarray, weight: np.ndarray) -> np.ndarray:
    rows, columns = np.nonzero(spot)
    share = weight[rows, columns].astype(float) + 1e-6
    row, column = np.average(rows, weights=share), np.average(columns, weights=share)
    away = np.stack([rows - row, columns - column])
    long = np.linalg.eigvalsh((away * share) @ away.T / share.sum())[-1]
    return np.array([row, column, share.sum(), np.sqrt(max(long, 0.0))])


def _followed(frames: list[list[np.ndarray]], count: int) -> Float[np.ndarray, "T count 4"]:
    """Return the spots of each frame in the order in which those before would go on; NaN for one that is not there.

    Each part goes on with its last velocity, for less certain the longer it has not been seen. Frames with more spots
    than parts do not count.
    """
    places = np.full((len(frames), count, 4), np.nan)
    # Of each part: the last frame in which it was seen, and its place and velocity there.
    when, where, speed = np.zeros(count), np.zeros((count, 2)), np.zeros((count, 2))
    begun = False
    for t, spots in enumerate(frames):
        if not spots or len(spots) > count or (not begun and len(spots) < count):
            continue
        now = np.stack(spots)
        order = list(range(count))
        if begun:
            off = np.linalg.norm(now[:, None, :2] - (where + speed * (t - when)[:, None])[None], axis=-1) / (t - when)
            orders = [list(each) for each in itertools.permutations(range(count), len(spots))]
            order = min(orders, key=lambda each: float(np.sum(off[np.arange(len(spots)), each] ** 2)))
        places[t, order] = now
        if begun:
            speed[order] = (now[:, :2] - where[order]) / (t - when[order])[:, None]
        when[order], where[order], begun = t, now[:, :2], True
    return places
