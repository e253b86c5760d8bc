"""Figures of a data set: pictures, motion, the threshold of the valid prediction time, check-sums."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from keycld._errors import KeycldError
from keycld._files import write_text
from keycld.data.drawn import with_pictures
from keycld.data.store import blocks, read, recordings

_NAME = "statistics.json"
# Recordings whose pictures are looked at.
PICTURED = 1000


def sha256(path: Path) -> str:
    """The check-sum of a file, in hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_statistics(folder: Path) -> dict[str, Any] | None:
    """What `statistics.json` of a folder says, or None where there is none.

    Raises:
        KeycldError: the file is damaged.
    """
    path = folder / _NAME
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise KeycldError(f"{path} is damaged ({error}): delete it and make the data again.") from error


def write_statistics(folder: Path, figures: dict[str, Any]) -> None:
    """Write `statistics.json`."""
    write_text(folder / _NAME, json.dumps(figures, indent=1) + "\n")


def split_statistics(path: Path) -> dict[str, Any]:
    """Figures of one file: counts, size, check-sum, pictures and motion (grey levels in [0, 1]).

    Those of pictures are of the first 1,000 recordings; where there are more, `pictured` says so.
    """
    first = with_pictures(read(path, rows=slice(0, PICTURED)))
    figures: dict[str, Any] = {
        "trajectories": recordings(path),
        "frames": first.frames,
        "bytes": path.stat().st_size,
        "sha256": sha256(path),
    }
    if first.image is not None:
        figures |= image_statistics(first.image)
        if len(first) < figures["trajectories"]:
            figures["pictured"] = len(first)
    if first.state is not None:
        figures["motion_per_frame"] = _motion(path, first.attributes.get("state_names"))
    return figures


def image_statistics(image: np.ndarray) -> dict[str, Any]:
    """Mean and deviation of all grey levels, and ε, of `image` uint8 [N, T, H, W, 3].

    ε is the mean squared error of predicting the mean frame, that is the mean over pixels of each one's
    variance; of the validation split it is the threshold of the valid prediction time (KeyCLD, section 4).
    """
    flat = image.reshape(-1, *image.shape[2:])
    total, squares = np.zeros(flat.shape[1:]), np.zeros(flat.shape[1:])
    # Some hundred frames at a time: the whole set as floats would not fit small machines.
    for first in range(0, len(flat), 512):
        block = flat[first : first + 512].astype(np.float32) / 255.0
        total += block.sum(axis=0, dtype=np.float64)
        squares += np.square(block).sum(axis=0, dtype=np.float64)
    mean, square = total / len(flat), squares / len(flat)
    return {
        "mean": float(mean.mean()),
        "deviation": float(np.sqrt(max(square.mean() - mean.mean() ** 2, 0.0))),
        "epsilon": float(np.mean(np.maximum(square - mean**2, 0.0))),
    }


def _motion(path: Path, names: Sequence[str] | None) -> dict[str, dict[str, float]]:
    """Each component's largest change between two frames of a recording: the fastest moment decides."""
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
