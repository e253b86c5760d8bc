"""Figures of one file: counts, pictures, motion, and the threshold of the valid prediction time."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from keycld.data.format.derived import picture_shape, with_pictures
from keycld.data.format.folder import sha256
from keycld.data.format.reading import blocks, read, read_each, recordings

# The figures of pictures are those of so many recordings.
PICTURED = 1000
# Recordings whose pictures are in memory at a time.
_BLOCK = 16


def split_statistics(path: Path) -> dict[str, Any]:
    """Compute figures of one file: counts, size, check-sum, pictures and motion (grey levels in [0, 1]).

    Those of pictures are of the first 1,000 recordings; if there are more, `pictured` says so.
    """
    count, first = recordings(path), read(path, images=False, rows=slice(0, 1))
    figures: dict[str, Any] = {
        "trajectories": count,
        "frames": first.frames,
        "bytes": path.stat().st_size,
        "sha256": sha256(path),
    }
    if picture_shape(path) is not None:
        figures |= image_statistics(first_pictures(path))
        if count > PICTURED:
            figures["pictured"] = PICTURED
    if first.state is not None:
        figures["motion_per_frame"] = _motion(path, first.attributes.get("state_names"))
    return figures


def first_pictures(path: Path) -> Iterator[UInt8[np.ndarray, "_ T H W 3"]]:
    """Yield the pictures of the first 1,000 recordings of a file, stored or rendered, a few recordings at a time."""
    last = min(PICTURED, recordings(path))
    rows = [slice(first, min(first + _BLOCK, last)) for first in range(0, last, _BLOCK)]
    for block in read_each(path, rows):
        image = with_pictures(block).image
        assert image is not None
        yield image


def image_statistics(blocks: Iterable[UInt8[np.ndarray, "_ T H W 3"]]) -> dict[str, Any]:
    """Compute mean and deviation of all grey levels, and ε, from pictures that come some recordings at a time.

    ε is the mean squared error of predicting the mean frame, which is the mean over pixels of the variance of each. Of
    the validation split it is the threshold of the valid prediction time (KeyCLD, section 4).
    """
    total, squares, count = 0.0, 0.0, 0
    for block in blocks:
        for recording in block:
            frames = recording.astype(np.float32) / 255.0
            total = total + frames.sum(axis=0, dtype=np.float64)
            squares = squares + np.square(frames).sum(axis=0, dtype=np.float64)
            count += len(frames)
    mean, square = total / count, squares / count
    return {
        "mean": float(np.mean(mean)),
        "deviation": float(np.sqrt(max(np.mean(square) - np.mean(mean) ** 2, 0.0))),
        "epsilon": float(np.mean(np.maximum(square - mean**2, 0.0))),
    }


def _motion(path: Path, names: Sequence[str] | None) -> dict[str, dict[str, float]]:
    """Compute the largest change of each component between two frames of a recording: the fastest moment decides."""
    states = (block.state for block in blocks(path))
    steps = np.concatenate([np.abs(np.diff(state, axis=1)).max(axis=1) for state in states if state is not None])
    return {
        name: {
            "median": float(np.median(steps[:, i])),
            "p90": float(np.quantile(steps[:, i], 0.9)),
            "largest": float(steps[:, i].max()),
        }
        for i, name in enumerate(names or map(str, range(steps.shape[-1])))
    }
