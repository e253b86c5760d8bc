"""Reads trajectories from an HDF5 file: all of them, some, or block by block."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from keycld._errors import KeycldError
from keycld.data.format.hdf5 import open_file
from keycld.data.format.rules import EVERY, check_images, check_structure, check_values, recordings_in
from keycld.data.format.trajectories import Trajectories


def read(path: str | Path, *, images: bool = True, rows: slice = EVERY) -> Trajectories:
    """Read one HDF5 file, or some of its recordings, and check it.

    Args:
        path: the file.
        images: False leaves the pictures on the disk (`image` is None).
        rows: which recordings, such as `slice(0, 100)`; the values of the others are not checked.

    Raises:
        KeycldError: says what is wrong in the file, where, and how to fix it.
    """
    [trajectories] = read_each(path, [rows], images=images)
    return trajectories


def read_each(path: str | Path, rows: Iterable[slice], *, images: bool = True) -> Iterator[Trajectories]:
    """Read several groups of recordings of one file, one group at a time.

    Args:
        path: the file; it stays open until the last group.
        rows: the recordings of each group.
        images: False leaves the pictures on the disk (`image` is None).

    Raises:
        KeycldError: as `read`.
    """
    with open_file(path) as file:
        refuse(check_structure(file, slice(0, 0)), path)
        for group in rows:
            refuse(check_values(file, group), path)
            trajectories = _load_small(file, group)
            if images and "image" in file:
                trajectories = dataclasses.replace(trajectories, image=_pictures(file, group, path))
            yield trajectories


def blocks(path: str | Path, size: int = 1000, *, images: bool = False) -> Iterator[Trajectories]:
    """Read all recordings of a file, `size` at a time, for files that do not fit into memory."""
    first = range(0, recordings(path), size)
    return read_each(path, [slice(k, k + size) for k in first], images=images)


def recordings(path: str | Path) -> int:
    """Count the recordings of a file."""
    with open_file(path) as file:
        refuse(check_structure(file, slice(0, 0)), path)
        return recordings_in(file)


def refuse(problems: Sequence[str], path: str | Path) -> None:
    """Raise the first of the problems of a file, if there are any."""
    if problems:
        more = f" (and {len(problems) - 1} more; 'keycld data check' lists all)" if len(problems) > 1 else ""
        raise KeycldError(f"{path}: {problems[0]}{more}")


def _pictures(file: Any, rows: slice, path: str | Path) -> np.ndarray:
    try:
        return np.asarray(file["image"][rows])
    except OSError:
        refuse(check_images(file), path)
        raise


def _load_small(file: Any, rows: slice) -> Trajectories:
    """Read everything except the pictures, in the types of the format."""

    def optional(name: str) -> np.ndarray | None:
        return np.asarray(file[name][rows], np.float64) if name in file else None

    return Trajectories(
        time=np.asarray(file["time"], np.float64),
        input=_input(file, rows),
        state=optional("state"),
        state_derivative=optional("state_derivative"),
        parameters={name: _parameter(dataset, rows) for name, dataset in file.get("parameters", {}).items()},
        attributes={key: _plain(value) for key, value in file.attrs.items()},
    )


def _input(file: Any, rows: slice) -> np.ndarray:
    """Read the input; [N, 0] if nothing drives the motion."""
    if "input" in file and file["input"].shape[-1] > 0:
        return np.asarray(file["input"][rows], np.float32)
    return np.zeros((len(range(recordings_in(file))[rows]), 0), np.float32)


def _parameter(dataset: h5py.Dataset, rows: slice) -> np.ndarray:
    if h5py.check_string_dtype(dataset.dtype) is not None:
        return np.asarray(dataset.asstr()[rows], dtype=np.str_)
    return np.asarray(dataset[rows])


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return tuple(value.tolist())
    return value.item() if isinstance(value, np.generic) else value
