"""The runs that a data set holds: the protocols of the papers, and the splits that nothing is tuned on."""

import dataclasses
import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from keycld._errors import KeycldError, unknown
from keycld.systems import Conditions


@dataclass(frozen=True)
class Split:
    """Runs of one file.

    Attributes:
        name: the file is NAME.h5.
        seeds: `(first, last + 1)`, one generator `numpy.random.RandomState(seed)` a run.
        frames: of each run.
        conditions: inputs and initial states.
        screened: whether runs that leave the image or turn more than 1 rad between two frames are sampled again from
            the same generator.
    """

    name: str
    seeds: tuple[int, int]
    frames: int
    conditions: Conditions
    screened: bool = False

    def __len__(self) -> int:
        """Return the number of runs."""
        return self.seeds[1] - self.seeds[0]


_CONDITIONS: Mapping[str, Conditions] = {
    "keycld-2022": Conditions(),
    "keycld-2024": Conditions(initial_state="random", input_limit=2.0, clip=False, idle_number=False),
    "zoo": Conditions(initial_state="moving"),
}
PROTOCOLS = tuple(_CONDITIONS)
# Seeds 0 ... 499 are the papers' (the last 50 for validation); no choice is ever made on the two test splits.
_FIRST_SEED = {"train": 0, "validation": 450, "test": 500, "test_long": 1000}
# Where the seeds of a split begin that has more recordings than there are seeds before those of the next one; with
# more recordings than this, two files would share seeds.
_FAR = 1_000_000
_RUNS = {"train": 450, "validation": 50, "test": 50, "test_long": 50}
_FRAMES = {"train": 50, "validation": 50, "test": 50, "test_long": 500}
# The zoo's frames are further apart in time than those of the papers' systems, and its friction ends some motions.
_ZOO_LONG = 200


def splits(
    protocol: str,
    *,
    control: str | None = None,
    initial_state: str | None = None,
    clip: bool | None = None,
    input: str | None = None,
    runs: Mapping[str, int] | None = None,
    frames: Mapping[str, int] | None = None,
) -> tuple[Split, ...]:
    """Return the splits of a protocol.

    Args:
        protocol: one of `PROTOCOLS`.
        control: which inputs act, instead of the protocol's choice.
        initial_state: how runs begin, instead of the protocol's choice.
        clip: whether the motors limit the input, instead of the protocol's choice.
        input: `"constant"` or `"random-walk"`, instead of the protocol's choice.
        runs: numbers of runs by split, for smaller sets (a run depends on its seed and its length only).
        frames: numbers of frames by split.

    Raises:
        KeycldError: an unknown protocol or split, or a number below 1 recording or 3 frames.

    Good values: the defaults; `runs` and `frames` are for tests.
    """
    if protocol not in _CONDITIONS:
        raise unknown("protocol", protocol, PROTOCOLS)
    changes: dict[str, Any] = {"control": control, "initial_state": initial_state, "clip": clip, "input": input}
    conditions = dataclasses.replace(
        _CONDITIONS[protocol], **{name: value for name, value in changes.items() if value is not None}
    )
    zoo = protocol == "zoo"
    undriven = Conditions(control="none", initial_state="moving" if zoo else "released", clip=conditions.clip)
    counts = recording_counts(_RUNS, runs, dict.fromkeys(_RUNS, 1))
    first = dict(_FIRST_SEED)
    for number, (name, following) in enumerate(itertools.pairwise(_FIRST_SEED)):
        if counts[name] > _FIRST_SEED[following] - _FIRST_SEED[name]:
            first[name] = _FAR * (1 + number)
    lengths = _FRAMES | ({"test_long": _ZOO_LONG} if zoo else {})
    lengths = with_numbers(lengths, frames, dict.fromkeys(_FRAMES, 3), "frames")
    return tuple(
        Split(
            name,
            (first[name], first[name] + counts[name]),
            lengths[name],
            undriven if name == "test_long" else conditions,
            screened=zoo or name == "test_long",
        )
        for name in _RUNS
    )


def recording_counts(
    usual: Mapping[str, int], given: Mapping[str, int] | None, least: Mapping[str, int], of: str = ""
) -> dict[str, int]:
    """Return numbers of recordings by split, as `with_numbers`; of the long test no more than of the test.

    A small set is made quickly only if it has few long recordings too.
    """
    counts = with_numbers(usual, given, least, "recordings", of)
    if "test_long" in counts and "test_long" not in (given or {}):
        counts["test_long"] = min(counts["test_long"], counts["test"])
    return counts


def with_numbers(
    numbers: Mapping[str, int], given: Mapping[str, int] | None, least: Mapping[str, int], what: str, of: str = ""
) -> dict[str, int]:
    """Return numbers by split, some of them replaced.

    Args:
        numbers: by split.
        given: those that replace them.
        least: the smallest number that each split may have.
        what: is counted, "recordings" or "frames"; numbers of recordings are flags of the command line.
        of: the system, where its splits are its own.

    Raises:
        KeycldError: an unknown split, or a number that is too small or too large.
    """
    for name, number in (given or {}).items():
        if name not in numbers:
            raise unknown("split", name, numbers, of=of)
        if not least[name] <= number <= _FAR:
            flag = "--long" if name == "test_long" else f"--{name}"
            raise KeycldError(
                f"{flag if what == 'recordings' else name} is a number of {what}, at least {least[name]} and at most "
                f"{_FAR:,}, not {number:,}."
            )
    return {**numbers, **(given or {})}
