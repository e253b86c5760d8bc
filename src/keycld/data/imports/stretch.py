"""Which frames of a video show the mechanism alone: no hand that releases it, no passer-by, no start at rest.

And whether it leaves the picture.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, UInt8

# Pixels of the picture's edge, how many of them differ where something reaches in from there, and in which share of the
# frames a part of the mechanism does so at least.
_EDGE, _SEVERAL, _USUAL = 2, 3, 0.4
# By which factor a visitor makes more of the picture differ than the mechanism alone does: one who is there only at the
# beginning or only at the end; any other. Below 1: by which less differs where a part has left the picture.
_MORE_ONCE, _MORE, _LESS = 1.2, 1.4, 0.8
# Seconds: of a flash in the middle, which is no visitor; before and after one.
_FLASH, _AROUND = 0.2, 0.1
# Seconds over which motion is looked for; the share of the usual change below which nothing moves, and for how long.
_STEP, _STILL, _REST = 0.1, 0.15, 0.4


def undisturbed(grey: UInt8[np.ndarray, "T h w"], differs: Bool[np.ndarray, "T h w"], dt: float) -> tuple[int, int]:
    """Return the first frame of the longest stretch that shows the mechanism alone, in motion, and the one after it.

    A hand or a passer-by reaches into the picture from its edge, in less than two fifths of the frames, and makes more
    of it differ; so does a camera that is touched at the end. A mechanism that stands still and then moves was held: no
    law of its own motion explains that.

    Args:
        grey: frames.
        differs: which pixels are not as usual in each.
        dt: seconds between them.
    """
    alone = _stretches(_alone(differs, dt))
    first, last = max(alone, key=lambda stretch: stretch[1] - stretch[0], default=(0, len(grey)))
    return first + _held(grey[first:last], dt), last


def leaving(differs: Bool[np.ndarray, "T h w"]) -> tuple[list[str], float]:
    """Return at which edges parts leave the picture, and in which share of the frames one is out of it.

    Less of the picture differs while something reaches that edge.

    Args:
        differs: which pixels are not as usual in each frame.
    """
    size, out, edges = np.sum(differs, axis=(1, 2)), np.zeros(len(differs), bool), []
    for name, there in _reached(differs):
        if 0 < np.mean(there) < 1 and _growth(size, there) < _LESS:
            edges.append(name)
            out |= there
    return edges, float(np.mean(out))


def _alone(differs: Bool[np.ndarray, "T h w"], dt: float) -> Bool[np.ndarray, "T"]:
    """Return in which frames nothing reaches in."""
    from scipy import ndimage

    size = np.sum(differs, axis=(1, 2))
    found = np.zeros(len(differs), bool)
    for _, reached in _reached(differs):
        long = max(1, round(_FLASH / dt))
        there = ndimage.binary_opening(np.pad(reached, long, "edge"), np.ones(long))[long:-long]
        once = len(_stretches(there)) == 1 and bool(there[0] or there[-1])
        if 0 < np.mean(there) < _USUAL and _growth(size, there) > (_MORE_ONCE if once else _MORE):
            found |= there
    around = np.ones(1 + 2 * round(_AROUND / dt))
    return np.logical_not(ndimage.binary_dilation(found, around))


def _reached(differs: Bool[np.ndarray, "T h w"]) -> Iterator[tuple[str, Bool[np.ndarray, "T"]]]:
    """Yield the name of each edge of the picture, and in which frames something is there."""
    e, upright = _EDGE, differs.swapaxes(1, 2)
    edges = {"left": upright[:, :e], "right": upright[:, -e:], "upper": differs[:, :e], "lower": differs[:, -e:]}
    for name, edge in edges.items():
        yield name, np.sum(np.any(edge, axis=1), axis=1) >= _SEVERAL


def _growth(size: np.ndarray, there: Bool[np.ndarray, "T"]) -> float:
    """Return by which factor more of the picture differs in these frames than in the others."""
    return float(np.median(size[there]) / max(np.median(size[np.logical_not(there)]), 1))


def _stretches(mask: Bool[np.ndarray, "T"]) -> list[tuple[int, int]]:
    """Return where runs of True begin, and the index after each."""
    turns = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return list(zip(turns[::2].tolist(), turns[1::2].tolist(), strict=True))


def _held(grey: UInt8[np.ndarray, "T h w"], dt: float) -> int:
    """Return how many frames at the beginning show no motion, where these last for a while."""
    step = max(1, round(_STEP / dt))
    change = np.abs(grey[step:].astype(np.int16) - grey[:-step])
    changed = np.sum(change > max(12.0, 6 * float(np.median(np.std(change.astype(float), axis=0)))), axis=(1, 2))
    still = int(np.argmax(changed >= _STILL * np.percentile(changed, 90)))
    return still if still * dt > _REST else 0
