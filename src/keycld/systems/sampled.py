"""Systems whose trajectories follow from a number. Needs no JAX."""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from keycld.systems.base import AbstractSystem
from keycld.systems.pictures import Pictures

# The protocols of "Which priors matter?": the released configurations, and the text of the paper where it differs.
RELEASED, PAPER = "priors-released", "priors-paper"
# Trajectories of each file, the same for both sizes of a set: as published, and with a long test of our own.
_TRAIN_AND_TEST = {"train": 50_000, "test": 20_000}
PUBLISHED_COUNTS = {size: _TRAIN_AND_TEST for size in ("default", "full")}
COUNTS_WITH_LONG = {size: {**_TRAIN_AND_TEST, "test_long": 200} for size in ("default", "full")}


class Recording(NamedTuple):
    """N trajectories of T frames, without their pictures; arrays are float64 unless they count something.

    Attributes:
        time: [T], seconds; 0 at the first frame, which shows the initial state.
        state: [N, T, d].
        parameters: arrays [N, ...], constant along a trajectory.
    """

    time: np.ndarray
    state: np.ndarray
    parameters: dict[str, np.ndarray]


class AbstractSampledSystem(AbstractSystem):
    """A system whose trajectories follow from their numbers, without input.

    Attributes:
        protocols: the ways to sample trajectories that it knows, the default first. `"priors-released"`: the
            released configurations; `"priors-paper"`: the text of the paper where the two differ.
        counts: trajectories of each file by size: `{"default": {"train": ..., "test": ...}, "full": ...}`; "train"
            counts those of validation too.
    """

    size: ClassVar[int] = 32
    protocols: ClassVar[tuple[str, ...]]
    counts: ClassVar[Mapping[str, Mapping[str, int]]]

    @abc.abstractmethod
    def record(self, numbers: range, frames: int, protocol: str, size: str) -> Recording:
        """Compute the trajectories of these numbers; each depends on its number, the protocol and the size only."""

    @abc.abstractmethod
    def group(self, frames: int, size: str, images: bool) -> int:
        """Return how many consecutive numbers are best recorded at once, with their pictures or without."""

    def related(self, size: str) -> int:
        """Return how many consecutive numbers, counted from a multiple, are parts of one simulation.

        Such trajectories are correlated, so they never lie in two files; 1 where all are independent.
        """
        return 1

    @abc.abstractmethod
    def pictures(self, recording: Recording) -> Pictures:
        """Render a recording: `image` uint8 `[N, T, size, size, 3]`."""


def numbers_only(parameters: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the parameters without texts."""
    return {name: value for name, value in parameters.items() if value.dtype.kind in "fiu"}


def in_single_precision(parameters: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the parameters without texts, with 32 bits a number."""
    kinds: dict[str, Any] = {"f": np.float32, "i": np.int32, "u": np.int32}
    return {name: value.astype(kinds[value.dtype.kind]) for name, value in numbers_only(parameters).items()}
