"""Writes trajectories to an HDF5 file, and joins files."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from keycld.data.format.hdf5 import create_file, open_file
from keycld.data.format.reading import recordings, refuse
from keycld.data.format.rules import SCHEMA_VERSION, check_structure
from keycld.data.format.trajectories import Trajectories

# Successive frames are alike and lie within deflate's window of 32 kB: level 4 makes pendulum pictures 28 times
# smaller and takes no more time than level 1 (10 times smaller) or LZF (1.5 times). Shuffling has no effect on bytes.
_COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 4}


def write(path: str | Path, trajectories: Trajectories) -> None:
    """Write one HDF5 file: under a temporary name, flushed to the disk, then renamed.

    `read(path)` gives the same arrays back. If `trajectories` violate a rule of the format, nothing is written.

    Raises:
        KeycldError: the contents violate the format; the folder cannot be written; the disk is full.
    """
    with create_file(path) as file:
        _write_small(file, trajectories)
        if trajectories.image is not None:
            image = np.asarray(trajectories.image)
            # One chunk a recording, because a clip is cut from one recording.
            file.create_dataset("image", data=image, chunks=(1, *image.shape[1:]), **_COMPRESSION)
        refuse(check_structure(file), path)


def _write_small(file: h5py.File, trajectories: Trajectories) -> None:
    """Write everything except the pictures."""
    for key, value in {"schema_version": SCHEMA_VERSION, **trajectories.attributes}.items():
        file.attrs[key] = list(value) if isinstance(value, tuple | list) else value
    file["time"] = np.asarray(trajectories.time, np.float64)
    file["input"] = np.asarray(trajectories.input, np.float32)
    for name, value in {"state": trajectories.state, "state_derivative": trajectories.state_derivative}.items():
        if value is not None:
            file[name] = np.asarray(value, np.float64)
    for name, value in trajectories.parameters.items():
        value = np.asarray(value)
        file[f"parameters/{name}"] = value.astype(h5py.string_dtype()) if value.dtype.kind == "U" else value


def join(parts: Sequence[Path], path: Path) -> None:
    """Write one file with the recordings of several, in their order; the first one's attributes are kept.

    Compressed pictures are copied as they are, one recording at a time, so this needs little time and memory.

    Raises:
        KeycldError: as `write` and `read`.
    """
    counts = [recordings(part) for part in parts]
    with open_file(parts[0]) as first:
        attributes, times = dict(first.attrs), first["time"][...]
        layout = {name: (first[name].shape[1:], first[name].dtype, first[name].chunks) for name in _fields(first)}
    with create_file(path) as new:
        file: Any = new
        file.attrs.update(attributes)
        file["time"] = times
        for name, (shape, kind, chunks) in layout.items():
            stored = _COMPRESSION | {"chunks": chunks} if name == "image" else {}
            file.create_dataset(name, (sum(counts), *shape), kind, **stored)
        for row, part in zip(np.cumsum([0, *counts]), parts, strict=False):
            with open_file(part) as source:
                small = {name: source[name][...] for name in _fields(source) if name != "image"}
            for name, values in small.items():
                file[name][row : row + len(values)] = values
            for i, (mask, chunk) in enumerate(_chunks(part)):
                file["image"].id.write_direct_chunk((row + i, 0, 0, 0, 0), chunk, mask)


def _fields(file: Any) -> list[str]:
    """List the names of all fields that have one row a recording."""
    fields = [name for name in ("input", "image", "state", "state_derivative") if name in file]
    return fields + [f"parameters/{name}" for name in file.get("parameters", {})]


def _chunks(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the compressed pictures of each recording: filter mask and bytes."""
    with open_file(path) as file:
        for index in range(len(file.get("image", ()))):
            yield file["image"].id.read_direct_chunk((index, 0, 0, 0, 0))
