"""The training set, however large: resident as a whole, or shard by shard.

A set that fits into the budget is resident as a whole. Of a larger one, a shard is resident: as many trajectories as
half of the budget holds. After some steps the next shard takes its place, which a thread has read meanwhile into the
other half.
"""

import threading
import weakref
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from pathlib import Path

import numpy as np
from jaxtyping import Int

from keycld._errors import KeycldError
from keycld.data.format.derived import MOST_BYTES
from keycld.data.format.reading import read, read_each, recordings
from keycld.data.format.trajectories import Trajectories
from keycld.data.sample.resident import Host, Resident, needed_renderer, on_device, on_host

# Recordings read at once: few enough to be negligible in memory.
_BLOCK = 16


class TrainingData:
    """The trajectories of one file as `Resident`s, one for each range of steps.

    The shards are consecutive parts of an endless sequence: a random permutation of all trajectories, then another one,
    and so on. Which trajectories are resident is a function of seed and step, so a resumed run sees the same clips. All
    shards have the same shape, so a step compiles once.

    Attributes:
        shape: (N, T, H, W, 3) of the whole set.
        shard: trajectories that are resident at a time; N if the set fits into the budget.
        shard_steps: steps for which a shard is resident.
    """

    SHARD_STEPS = 2000

    def __init__(
        self, path: Path, seed: int, *, budget_bytes: int | float = MOST_BYTES, shard_steps: int = SHARD_STEPS
    ):
        """Measure the set; nothing is read before `at`.

        Args:
            path: the HDF5 file.
            seed: decides the order of the trajectories.
            budget_bytes: memory for both shards, the resident one and the next one.
            shard_steps: steps for which a shard is resident. Good values: long enough to read the next shard
                meanwhile, about a minute for the default budget, and to sample each resident trajectory a few times.

        Raises:
            KeycldError: the budget does not hold two trajectories, or there are neither pictures nor a renderer.
        """
        first = read(path, rows=slice(0, 1))
        one, self._system = on_host([first], 1), needed_renderer(first)
        count, fitting = recordings(path), int(budget_bytes // one.bytes)
        if fitting < min(count, 2):
            raise KeycldError(
                f"one trajectory of {path} takes {one.bytes / 1e6:.3g} MB but the memory for training data is "
                f"{budget_bytes / 1e6:.3g} MB: allow at least {2 * one.bytes / 1e6:.3g} MB."
            )
        self._path, self._seed, self._dt = path, seed, first.dt
        self.shape = (count, *on_device(one, self._system, first.dt).shape[1:])
        self.shard = count if fitting >= count else fitting // 2
        self.shard_steps = shard_steps
        self._number: int | None = None
        self._resident: Resident | None = None
        self._ahead: _Reading | None = None

    def at(self, step: int) -> Resident:
        """Give the trajectories that are resident at a step, counted over all stages.

        The caller must not keep those of earlier steps: the next shard is read into their half of the budget.

        Raises:
            KeycldError: the file is damaged.
        """
        number = 0 if self.shard == self.shape[0] else step // self.shard_steps
        if self._resident is not None and number == self._number:
            return self._resident
        ahead, self._ahead = self._ahead, None
        if ahead is None or ahead.number != number:
            if ahead is not None:
                ahead.stop()
            ahead = self._read(number)
        host = ahead.result()
        self._number, self._resident = number, on_device(host, self._system, self._dt)
        if self.shard < self.shape[0]:
            self._ahead = self._read(number + 1)
        return self._resident

    def until(self, step: int) -> int | None:
        """Tell the first later step at which other trajectories are resident; None if there is none."""
        return None if self.shard == self.shape[0] else (step // self.shard_steps + 1) * self.shard_steps

    def trajectories(self, number: int) -> Int[np.ndarray, "shard"]:
        """List the trajectories of a shard, in ascending order."""
        count = self.shape[0]
        if self.shard == count:
            return np.arange(count)
        first, last = number * self.shard, (number + 1) * self.shard
        epochs = range(first // count, (last - 1) // count + 1)
        order = np.concatenate([np.random.default_rng([self._seed, epoch]).permutation(count) for epoch in epochs])
        begin = first - epochs[0] * count
        return np.sort(order[begin : begin + self.shard])

    def _read(self, number: int) -> "_Reading":
        return _Reading(number, self._path, self.trajectories(number))


class _Reading:
    """A shard that a thread reads."""

    def __init__(self, number: int, path: Path, rows: Int[np.ndarray, "shard"]):
        self.number = number
        self._future: Future[Host] = Future()
        stop = threading.Event()
        # A daemon, because a program that ends must not wait for a shard that nobody will use.
        thread = threading.Thread(target=_read_shard, args=(path, rows, self._future, stop), daemon=True)
        # At exit as well: HDF5 must not be in use while the interpreter ends.
        self.stop = weakref.finalize(self, _end, thread, stop)
        thread.start()

    def result(self) -> Host:
        return self._future.result()


def _end(thread: threading.Thread, stop: threading.Event) -> None:
    stop.set()
    if thread is not threading.current_thread():  # which may collect garbage too
        thread.join()


def _read_shard(path: Path, rows: Int[np.ndarray, "shard"], future: "Future[Host]", stop: threading.Event) -> None:
    try:
        blocks = _until_stopped(read_each(path, list(_consecutive(rows))), stop)
        future.set_result(on_host(blocks, len(rows)))
    except BaseException as error:
        future.set_exception(error)


def _until_stopped(blocks: Iterator[Trajectories], stop: threading.Event) -> Iterator[Trajectories]:
    for block in blocks:
        if stop.is_set():
            raise InterruptedError("nobody needs this shard any more")
        yield block


def _consecutive(rows: Sequence[int] | Int[np.ndarray, "shard"]) -> Iterator[slice]:
    """Group ascending numbers into slices of consecutive ones."""
    breaks = np.flatnonzero(np.diff(rows) != 1) + 1
    for run in np.split(np.asarray(rows), breaks):
        for k in range(0, len(run), _BLOCK):
            yield slice(int(run[k]), int(run[min(k + _BLOCK, len(run)) - 1]) + 1)
