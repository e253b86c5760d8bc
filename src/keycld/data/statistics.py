"""Figures of a data set: pictures, motion, the threshold of the valid prediction time, check-sums."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from keycld.data.atomic import atomic
from keycld.data.store import read


def sha256(path: Path) -> str:
    """The check-sum of a file, in hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def statistics(folder: Path, names: Sequence[str]) -> dict[str, Any]:
    """What `statistics.json` holds on the files NAME.h5 of a folder."""
    splits: dict[str, Any] = {}
    for name in names:
        path = folder / f"{name}.h5"
        trajectories = read(path)
        image = trajectories.image
        figures: dict[str, Any] = {
            "trajectories": len(trajectories),
            "frames": trajectories.frames,
            "bytes": path.stat().st_size,
            "sha256": sha256(path),
        }
        if image is not None:
            figures |= _image_figures(image)
        splits[name] = figures
    return {"splits": splits}


def _image_figures(image: np.ndarray) -> dict[str, Any]:
    flat = image.reshape(-1, *image.shape[2:])
    # Sums in float64, some hundred frames at a time: the whole set as floats would not fit small machines.
    total, squares = np.zeros(flat.shape[1:]), np.zeros(flat.shape[1:])
    for first in range(0, len(flat), 512):
        block = flat[first : first + 512].astype(np.float32) / 255.0
        total += block.sum(axis=0, dtype=np.float64)
        squares += np.square(block).sum(axis=0, dtype=np.float64)
    mean = total / len(flat)
    variance = np.maximum(squares / len(flat) - mean**2, 0.0)
    return {
        "mean": float(mean.mean()),
        "deviation": float(np.sqrt(variance.mean())),
        "epsilon": float(variance.mean()),
    }


def write_statistics(folder: Path, figures: dict[str, Any]) -> None:
    """Write `statistics.json`."""
    with atomic(folder / "statistics.json") as temporary:
        temporary.write_text(json.dumps(figures, indent=1))
