"""Writes trajectories to an HDF5 file, and joins files."""

import contextlib
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from keycld._errors import KeycldError
from keycld._files import replacing
from keycld.data.format.reading import open_file, read, recordings, refuse
from keycld.data.format.rules import SCHEMA_VERSION, check_structure
from keycld.data.format.trajectories import Trajectories

# Successive frames are alike and lie within deflate's window of 32 kB: level 4 makes pendulum pictures 28 times
# smaller and takes no more time than level 1 (10 times smaller) or LZF (1.5 times). Shuffling has no effect on bytes.
_COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 4}
# Files are joined in memory up to this size.
_LARGE = 5e8


def write(path: str | Path, trajectories: Trajectories) -> None:
    """Write one HDF5 file: under a temporary name, flushed to the disk, then renamed.

    `read(path)` gives the same arrays back. If `trajectories` violate a rule of the format, nothing is written.

    Raises:
        KeycldError: the contents violate the format; the folder cannot be written; the disk is full.
    """
    with _new_file(Path(path)) as file:
        _write_small(file, trajectories)
        if trajectories.image is not None:
            image = np.asarray(trajectories.image)
            # One chunk a recording, because a clip is cut from one recording.
            file.create_dataset("image", data=image, chunks=(1, *image.shape[1:]), **_COMPRESSION)
        refuse(check_structure(file), path)


@contextlib.contextmanager
def _new_file(path: Path) -> Iterator[h5py.File]:
    """Make an HDF5 file in memory, written to `path` as a whole at the end.

    HDF5 itself may crash the process on a full disk. Compressed recordings are small enough for memory.
    """
    with h5py.File(path.name, "w", driver="core", backing_store=False, block_size=2**20) as file:
        yield file
        file.flush()
        contents = file.id.get_file_image()
    with replacing(path) as temporary:
        temporary.write_bytes(contents)


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
    if sum(part.stat().st_size for part in parts) > _LARGE:
        _join_on_disk(parts, path)
        return
    loaded = [read(part, images=False) for part in parts]
    first = loaded[0]
    everything = Trajectories(
        time=first.time,
        input=np.concatenate([each.input for each in loaded]),
        state=_joined([each.state for each in loaded]),
        state_derivative=_joined([each.state_derivative for each in loaded]),
        parameters={name: np.concatenate([each.parameters[name] for each in loaded]) for name in first.parameters},
        attributes=first.attributes,
    )
    with _new_file(path) as file:
        _write_small(file, everything)
        chunks = (chunk for part in parts for chunk in _chunks(part))
        for position, (mask, chunk, shape) in enumerate(chunks):
            if position == 0:
                whole = (len(everything), *shape)
                image = file.create_dataset("image", whole, np.uint8, chunks=(1, *shape), **_COMPRESSION)
            image.id.write_direct_chunk((position, 0, 0, 0, 0), chunk, mask)


def _joined(values: Sequence[np.ndarray | None]) -> np.ndarray | None:
    stored = [value for value in values if value is not None]
    return np.concatenate(stored) if stored else None


def _join_on_disk(parts: Sequence[Path], path: Path) -> None:
    """Join part by part, for files that do not fit into memory."""
    size = sum(part.stat().st_size for part in parts)
    free = shutil.disk_usage(path.parent).free
    if free < 1.05 * size:  # HDF5 itself may crash on a full disk
        raise KeycldError(
            f"{path} takes {size / 1e9:.1f} GB but the disk has {free / 1e9:.1f} GB left: free some space and run it "
            "again."
        )
    counts = [recordings(part) for part in parts]
    # An error while writing must not be reported as an error of a part: parts are read before anything is written.
    with open_file(parts[0]) as first:
        attributes, times = dict(first.attrs), first["time"][...]
        layout = {name: (first[name].shape[1:], first[name].dtype, first[name].chunks) for name in _fields(first)}
    with replacing(path) as temporary, h5py.File(temporary, "w") as new:
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
            for i, (mask, chunk, _) in enumerate(_chunks(part)):
                file["image"].id.write_direct_chunk((row + i, 0, 0, 0, 0), chunk, mask)


def _fields(file: Any) -> list[str]:
    """List the names of all fields that have one row a recording."""
    fields = [name for name in ("input", "image", "state", "state_derivative") if name in file]
    return fields + [f"parameters/{name}" for name in file.get("parameters", {})]


def _chunks(path: Path) -> Iterator[tuple[int, bytes, tuple[int, ...]]]:
    """Yield the compressed pictures of each recording: filter mask, bytes, and shape [T, H, W, 3]."""
    with open_file(path) as file:
        image = file.get("image", ())
        for index in range(len(image)):
            mask, chunk = image.id.read_direct_chunk((index, 0, 0, 0, 0))
            yield mask, chunk, image.shape[1:]
