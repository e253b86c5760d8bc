"""Trajectories in memory and in one HDF5 file."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from keycld._errors import KeycldError
from keycld.data.atomic import atomic

SCHEMA_VERSION = 1
TEXT_LISTS = ("state_names", "units", "input_names", "keypoints")


@dataclass(frozen=True)
class Trajectories:
    """N recordings of T frames; `docs/data-format.md` describes the file that holds them.

    **Fields:**

    - `time`: float64 `[T]`, seconds, the same for all.
    - `input`: float32 `[N, l]` (constant in a recording) or `[N, T, l]` (held from frame k to k + 1).
    - `image`: uint8 `[N, T, H, W, 3]`, or None where a renderer draws from the state.
    - `state`, `state_derivative`: float64 `[N, T, d]` or None; ground truth, for evaluation only.
    - `parameters`: arrays `[N, ...]` by name, constant along a recording.
    - `attributes`: `schema_version`, `system`, `dt`, `state_names`, `units`, `seed`, `generator`, `protocol`, ...
    """

    time: np.ndarray
    input: np.ndarray
    image: np.ndarray | None = None
    state: np.ndarray | None = None
    state_derivative: np.ndarray | None = None
    parameters: Mapping[str, np.ndarray] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        """The number of recordings."""
        return len(self.input)

    @property
    def frames(self) -> int:
        """Frames of a recording, T."""
        return len(self.time)

    @property
    def dt(self) -> float:
        """Seconds between frames."""
        return float(self.attributes["dt"])


def _write_images(file: h5py.File, image: np.ndarray) -> None:
    # One chunk a recording, because clips come from one at a time. Shuffling uint8 would do nothing.
    file.create_dataset("image", data=image, chunks=(1, *image.shape[1:]), compression="gzip", compression_opts=1)


def write(path: str | os.PathLike, trajectories: Trajectories) -> None:
    """Write one HDF5 file: under a temporary name, flushed to the disk, then renamed.

    **Raises:** `KeycldError` where the folder cannot be written or the disk is full.
    """
    with atomic(Path(path)) as temporary, h5py.File(temporary, "w") as file:
        for key, value in {"schema_version": SCHEMA_VERSION, **trajectories.attributes}.items():
            file.attrs[key] = list(value) if isinstance(value, tuple | list) else value
        file["time"] = np.asarray(trajectories.time, np.float64)
        file["input"] = np.asarray(trajectories.input, np.float32)
        if trajectories.image is not None:
            _write_images(file, trajectories.image)
        for name in ("state", "state_derivative"):
            value = getattr(trajectories, name)
            if value is not None:
                file[name] = np.asarray(value, np.float64)
        for name, value in trajectories.parameters.items():
            value = np.asarray(value)
            file[f"parameters/{name}"] = value.astype(h5py.string_dtype()) if value.dtype.kind == "U" else value


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return tuple(value.tolist())
    return value.item() if isinstance(value, np.generic) else value


def load(file: h5py.File, *, images: bool = True) -> Trajectories:
    """The contents of an open file, not checked; use `read`."""

    def array(name: str) -> np.ndarray | None:
        return np.asarray(file[name]) if name in file else None

    parameters = {}
    for name, dataset in file.get("parameters", {}).items():
        text = h5py.check_string_dtype(dataset.dtype) is not None
        parameters[name] = np.asarray(dataset.asstr()[...], dtype=np.str_) if text else np.asarray(dataset)
    return Trajectories(
        time=np.asarray(file["time"]),
        input=np.asarray(file["input"]),
        image=array("image") if images else None,
        state=array("state"),
        state_derivative=array("state_derivative"),
        parameters=parameters,
        attributes={key: _plain(value) for key, value in file.attrs.items()},
    )


def read(path: str | os.PathLike, *, images: bool = True) -> Trajectories:
    """Read one HDF5 file after checking it.

    **Arguments:** `images=False` leaves the pictures on the disk.

    **Raises:** `KeycldError` that says what is wrong, where, and the mend.
    """
    from keycld.data.check import check

    problems = check(path, images=images)
    if problems:
        more = f" (and {len(problems) - 1} more; see keycld data check)" if len(problems) > 1 else ""
        raise KeycldError(problems[0] + more)
    with h5py.File(path) as file:
        return load(file, images=images)
