"""Trajectories in memory and in one HDF5 file."""

import contextlib
import dataclasses
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from keycld._errors import KeycldError
from keycld._files import replacing
from keycld.data.rules import EVERY, SCHEMA_VERSION, check_images, check_structure

# Successive frames are alike and lie within deflate's window of 32 kB: level 4 makes pendulum pictures 28
# times smaller at no more time than level 1 (10 times smaller) or LZF (1.5 times). Shuffling does nothing
# for bytes.
_COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 4}
# Files are put together in memory up to this size.
_LARGE = 5e8


@dataclass(frozen=True)
class Trajectories:
    """N recordings of T frames; `docs/data-format.md` describes the file that holds them.

    Attributes:
        time: float64 [T], seconds, the same for all recordings. input: float32, [N, l] where it is constant
        in a recording or [N, T, l], held from frame k to k + 1. image: uint8 [N, T, H, W, 3], or None (a
        renderer draws from the state, or the pictures were not read). state: float64 [N, T, d] or None;
        ground truth, for evaluation only. state_derivative: float64 [N, T, d] or None. parameters: arrays
        [N, ...] by name, constant along a recording. attributes: `schema_version`, `system`, `dt`,
        `state_names`, `units`, `seed`, `generator`, `protocol` and what else the maker noted.
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


def write(path: str | Path, trajectories: Trajectories) -> None:
    """Write one HDF5 file: under a temporary name, flushed to the disk, then renamed.

    `read(path)` gives the same arrays back. Where `trajectories` break a rule of the format, nothing is
    written.

    Raises:
        KeycldError: the contents break the format; the folder cannot be written; the disk is full.
    """
    with _new_file(Path(path)) as file:
        _write_small(file, trajectories)
        if trajectories.image is not None:
            image = np.asarray(trajectories.image)
            # One chunk a recording, because clips are cut from one at a time.
            file.create_dataset("image", data=image, chunks=(1, *image.shape[1:]), **_COMPRESSION)
        _refuse(check_structure(file), path)


@contextlib.contextmanager
def _new_file(path: Path) -> Iterator[h5py.File]:
    """An HDF5 file in memory, written to `path` as a whole at the end.

    On a full disk HDF5 itself may crash the process; compressed recordings are small enough for memory.
    """
    with h5py.File(path.name, "w", driver="core", backing_store=False, block_size=2**20) as file:
        yield file
        file.flush()
        contents = file.id.get_file_image()
    with replacing(path) as temporary:
        temporary.write_bytes(contents)


def _write_small(file: h5py.File, trajectories: Trajectories) -> None:
    """All but the pictures."""
    for key, value in {"schema_version": SCHEMA_VERSION, **trajectories.attributes}.items():
        file.attrs[key] = list(value) if isinstance(value, tuple | list) else value
    file["time"] = np.asarray(trajectories.time, np.float64)
    file["input"] = np.asarray(trajectories.input, np.float32)
    for name in ("state", "state_derivative"):
        value = getattr(trajectories, name)
        if value is not None:
            file[name] = np.asarray(value, np.float64)
    for name, value in trajectories.parameters.items():
        value = np.asarray(value)
        file[f"parameters/{name}"] = value.astype(h5py.string_dtype()) if value.dtype.kind == "U" else value


def _refuse(problems: Sequence[str], path: str | Path) -> None:
    if problems:
        more = f" (and {len(problems) - 1} more; 'keycld data check' lists all)" if len(problems) > 1 else ""
        raise KeycldError(f"{path}: {problems[0]}{more}")


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return tuple(value.tolist())
    return value.item() if isinstance(value, np.generic) else value


def _parameter(dataset: h5py.Dataset, rows: slice) -> np.ndarray:
    if h5py.check_string_dtype(dataset.dtype) is not None:
        return np.asarray(dataset.asstr()[rows], dtype=np.str_)
    return np.asarray(dataset[rows])


def _load_small(file: Any, rows: slice = EVERY) -> Trajectories:
    """All but the pictures, in the format's own types."""

    def optional(name: str) -> np.ndarray | None:
        return np.asarray(file[name][rows], np.float64) if name in file else None

    return Trajectories(
        time=np.asarray(file["time"], np.float64),
        input=np.asarray(file["input"][rows], np.float32),
        state=optional("state"),
        state_derivative=optional("state_derivative"),
        parameters={name: _parameter(dataset, rows) for name, dataset in file.get("parameters", {}).items()},
        attributes={key: _plain(value) for key, value in file.attrs.items()},
    )


@contextlib.contextmanager
def open_file(path: str | Path) -> Iterator[Any]:
    """Open an HDF5 file for reading.

    Raises:
        KeycldError: there is none, it may not be read, or it is truncated or damaged, found now or while reading.
    """
    path = Path(path)
    if path.is_dir():
        raise KeycldError(f"{path} is a folder: name one of the .h5 files in it.")
    try:
        with h5py.File(path, "r") as file:
            yield file
    except FileNotFoundError:
        raise KeycldError(f"there is no file {path}: check the path.") from None
    except PermissionError:
        raise KeycldError(f"{path} may not be read: change its permissions.") from None
    except KeycldError:
        raise
    except Exception as error:  # on damaged bytes h5py may raise anything, or hand out None
        raise KeycldError(
            f"{path} is not a whole HDF5 file, it is truncated or damaged: copy or make it again ({error})."
        ) from error


def read(path: str | Path, *, images: bool = True, rows: slice = EVERY) -> Trajectories:
    """Read one HDF5 file, or some of its recordings, and check it.

    Args:
        path: the file.
        images: False leaves the pictures on the disk (`image` is None).
        rows: which recordings, such as `slice(0, 100)`; the others' numbers are not looked at.

    Raises:
        KeycldError: says what is wrong in the file, where, and the mend.
    """
    with open_file(path) as file:
        _refuse(check_structure(file, rows), path)
        trajectories = _load_small(file, rows)
        if not images or "image" not in file:
            return trajectories
        try:
            return dataclasses.replace(trajectories, image=np.asarray(file["image"][rows]))
        except OSError:
            _refuse(check_images(file), path)
            raise


def recordings(path: str | Path) -> int:
    """How many recordings a file holds."""
    with open_file(path) as file:
        return len(file["input"])


def blocks(path: str | Path, size: int = 1000) -> Iterator[Trajectories]:
    """A file's trajectories without their pictures, some at a time, for files that memory may not hold."""
    for first in range(0, recordings(path), size):
        yield read(path, images=False, rows=slice(first, first + size))


def join(parts: Sequence[Path], path: Path) -> None:
    """Write one file with the recordings of several, in their order; the first one's attributes are kept.

    Compressed pictures are copied as they are, one recording at a time, so this needs neither time nor
    memory.

    Raises:
        KeycldError: as `write` and `read`.
    """
    if sum(part.stat().st_size for part in parts) > _LARGE:
        _join_on_disk(parts, path)
        return
    loaded = [read(part, images=False) for part in parts]
    first = loaded[0]

    def joined(name: str) -> np.ndarray | None:
        values = [getattr(each, name) for each in loaded]
        return None if values[0] is None else np.concatenate(values)

    everything = Trajectories(
        time=first.time,
        input=np.concatenate([each.input for each in loaded]),
        state=joined("state"),
        state_derivative=joined("state_derivative"),
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


def _join_on_disk(parts: Sequence[Path], path: Path) -> None:
    """The same, part by part, for files that memory may not hold."""
    size = sum(part.stat().st_size for part in parts)
    free = shutil.disk_usage(path.parent).free
    if free < 1.05 * size:  # HDF5 itself may crash on a full disk
        raise KeycldError(
            f"{path} takes {size / 1e9:.1f} GB but the disk has {free / 1e9:.1f} GB left: free some space and run it "
            "again."
        )
    counts = [recordings(part) for part in parts]
    # What is wrong while writing must not be blamed on a part: parts are read before anything is written.
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
    """Names of all that has one row a recording."""
    fields = [name for name in ("input", "image", "state", "state_derivative") if name in file]
    return fields + [f"parameters/{name}" for name in file.get("parameters", {})]


def _chunks(path: Path) -> Iterator[tuple[int, bytes, tuple[int, ...]]]:
    """Each recording's compressed pictures: filter mask, bytes, and shape [T, H, W, 3]."""
    with open_file(path) as file:
        image = file.get("image", ())
        for index in range(len(image)):
            mask, chunk = image.id.read_direct_chunk((index, 0, 0, 0, 0))
            yield mask, chunk, image.shape[1:]
