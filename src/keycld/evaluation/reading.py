"""Trajectories with their pictures, some at a time: no split of pictures is in memory as a whole."""

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int

from keycld._errors import KeycldError
from keycld.evaluation.protocols import Protocol

if TYPE_CHECKING:
    from keycld.data import DataSet, Trajectories

_BLOCK_BYTES = 64e6
ALL = slice(None)


def blocks(
    data: "DataSet", split: str, rows: slice = ALL, *, multiple: int = 1
) -> Iterator[tuple[slice, "Trajectories"]]:
    """Yield trajectories of a file with their pictures, stored or rendered, up to 64 MB of pictures at a time.

    Args:
        data: the data set.
        split: which file.
        rows: which trajectories.
        multiple: blocks, the last one apart, hold a multiple of so many trajectories.

    Yields:
        which of the chosen trajectories, and themselves.

    Raises:
        KeycldError: there are no pictures, and nothing of ours renders them.
    """
    first, stop, step = rows.indices(data.count(split))
    count = len(range(first, stop, step))
    one = data.split(split, rows=slice(first, first + 1)).image
    if one is None:
        raise KeycldError(
            f"scores need pictures, but {split}.h5 of '{data.folder}' has no /image: add it, or make the data with "
            "`keycld data make`."
        )
    size = max(1, int(_BLOCK_BYTES / one.nbytes) // multiple) * multiple
    for begun in range(0, count, size):
        taken = slice(begun, min(begun + size, count))
        chosen = slice(first + step * taken.start, first + step * taken.stop, step)
        yield taken, data.split(split, rows=chosen)


def windows(data: "DataSet", protocol: Protocol, multiple: int) -> Iterator[tuple[slice, "Trajectories"]]:
    """Yield the protocol's trajectories, cut to its window, some at a time; what lies outside is left out.

    Raises:
        KeycldError: the recordings are too short, or without pictures.
    """
    frames = data.split(protocol.split, images=False, rows=slice(0, 1)).frames
    if frames < protocol.needs:
        taken_up = f" from frame {protocol.start} on" if protocol.start else ""
        raise KeycldError(
            f"protocol '{protocol.name}' scores {protocol.horizon} frames{taken_up} of {protocol.split}.h5, which has "
            f"{frames} frames: choose a protocol with fewer, or make the file with more."
        )
    for taken, recordings in blocks(data, protocol.split, slice(protocol.trajectories), multiple=multiple):
        yield taken, cut(recordings, protocol.start, protocol.needs)


def cut(trajectories: "Trajectories", first: int, stop: int) -> "Trajectories":
    """Return trajectories with frames `first` … `stop` − 1 alone; `time` begins at 0 again."""
    u, image, state = trajectories.input, trajectories.image, trajectories.state
    return dataclasses.replace(
        trajectories,
        time=trajectories.time[first:stop] - trajectories.time[first],
        input=u[:, first:stop] if u.ndim == 3 else u,
        image=None if image is None else image[:, first:stop],
        state=None if state is None else state[:, first:stop],
        state_derivative=None,
    )


def evenly(count: int, most: int) -> slice:
    """Return every k-th of `count` trajectories, with the least k that leaves no more than `most`."""
    return slice(None, None, max(1, -(-count // most)))


def coprime(step: int, frames: int) -> int:
    """Return the least number from `step` on without a common factor with `frames`, so that steps visit all times."""
    while np.gcd(step, frames) > 1:
        step += 1
    return step


def visited(taken: slice, frames: int, step: int) -> tuple[Int[np.ndarray, "M"], Int[np.ndarray, "M"]]:
    """Return where every `step`-th of all frames is that lies in the block `taken`: trajectories of it, and frames."""
    first = -(-taken.start * frames // step) * step
    n, t = np.divmod(np.arange(first, taken.stop * frames, step), frames)
    return n - taken.start, t
