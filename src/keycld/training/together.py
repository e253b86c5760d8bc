"""Several trainings at the same time, which take their steps in one program."""

import contextlib
import dataclasses
import threading
from collections.abc import Hashable
from concurrent.futures import Future
from typing import Any, NamedTuple

import equinox as eqx
import jax

from keycld.training.step import Fixed, Progress, Taken, take_steps, take_together


class Together:
    """Trainings of one recipe, each in a thread of its own, on other data or with other seeds.

    A roll-out is a long sequence of small programs. On a GPU each takes the time of its launch, for one training or for
    twenty, so twenty that take their steps together take little longer than one. On a CPU nothing is gained.

    Each dispatch waits until all trainings that have not ended have one. Those that differ in numbers only are one
    program (`take_together`), whose outcome is that of each alone, up to rounding; others follow one after the other.

    What happens between steps, such as a fit or a score, is for one training at a time: all of them would compile the
    same programs otherwise.

    Attributes:
        members: one for each training.
        turn: held by the training whose turn it is.
    """

    def __init__(self, number: int):
        """Expect a number of trainings."""
        self.members = tuple(Member(self, k) for k in range(number))
        self._expected = set(range(number))
        self._waiting: dict[int, _Dispatch] = {}
        self.turn = threading.Lock()
        self._lock = threading.Lock()

    def take(self, number: int, fixed: Fixed, progress: Progress) -> Taken:
        """Take some steps of a training, with those of the others, as `take_steps`."""
        mine = _Dispatch(fixed, progress, Future())
        with self._lock:
            self._waiting[number] = mine
            self._take_if_complete()
        return mine.outcome.result()

    def leave(self, number: int) -> None:
        """Let the others no longer wait for a training."""
        with self._lock:
            self._expected.discard(number)
            self._take_if_complete()

    def _take_if_complete(self) -> None:
        """Take all steps that wait, in the thread that completes them."""
        if not self._waiting or self._expected - self._waiting.keys():
            return
        # By number, so that the same trainings are the same program in every dispatch.
        waiting = [self._waiting[member] for member in sorted(self._waiting)]
        self._waiting = {}
        groups: dict[Hashable, list[_Dispatch]] = {}
        for each in waiting:
            groups.setdefault(_program(each), []).append(each)
        for alike in groups.values():
            try:
                outcomes = _taken(alike)
            except BaseException as error:
                for each in alike:
                    each.outcome.set_exception(error)
            else:
                for each, outcome in zip(alike, outcomes, strict=True):
                    each.outcome.set_result(outcome)


@dataclasses.dataclass(frozen=True)
class Member:
    """One of several trainings, for `train`. Its thread leaves at the end, also after an error.

    Attributes:
        group: all of them.
        number: its own.
    """

    group: Together
    number: int

    @property
    def turn(self) -> contextlib.AbstractContextManager[Any]:
        """Held while something happens between steps, or after the last one."""
        return self.group.turn

    def take(self, fixed: Fixed, progress: Progress) -> Taken:
        """Take some steps, as `take_steps`, together with the others."""
        return self.group.take(self.number, fixed, progress)

    def leave(self) -> None:
        """Let the others no longer wait for this training; twice does no harm."""
        self.group.leave(self.number)


class _Dispatch(NamedTuple):
    fixed: Fixed
    progress: Progress
    outcome: "Future[Taken]"


def _taken(alike: list[_Dispatch]) -> tuple[Taken, ...]:
    if len(alike) == 1:
        return (take_steps(alike[0].fixed, alike[0].progress),)
    return take_together(tuple(each.fixed for each in alike), tuple(each.progress for each in alike))


def _program(dispatch: _Dispatch) -> Hashable:
    """Return what is equal for dispatches that can be one program."""
    fixed = dispatch.fixed
    if fixed.devices.mesh is not None:
        return id(dispatch)
    data = fixed.data
    cached = None if data.cached is None else data.cached.shape[-1]
    # What the shape of clips depends on; numbers of trajectories and frames do not matter.
    clips = (data.shape[2:], data.u.ndim, data.u.shape[-1], cached)
    leaves, structure = jax.tree.flatten((fixed.chosen, fixed.rest, dispatch.progress))
    return fixed.rule, fixed.steps, clips, structure, tuple(_kind(leaf) for leaf in leaves)


def _kind(leaf: Any) -> Hashable:
    return (leaf.shape, leaf.dtype) if eqx.is_array(leaf) else leaf
