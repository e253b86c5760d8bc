"""What is given, what is scored, and against which threshold."""

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

from keycld._errors import KeycldError, unknown

if TYPE_CHECKING:
    from keycld.data import DataSet


@dataclass(frozen=True)
class Protocol:
    """How a prediction is scored.

    The model gets the first `given` frames and the inputs of each trajectory, and nothing else; frames 0 to
    `horizon` − 1 are scored, the given ones included, against ε of the validation set (eq. 16).

    Attributes:
        name: also the name of the stored result.
        split: which file of the data set, without `.h5`.
        horizon: T, frames scored.
        given: frames that the model sees. 2 in arXiv v1, 3 in the journal version.
        factors: thresholds, in units of ε, each scored on its own.
        shown: how many trajectories (the first of the file) keep their pictures for the report.

    Raises:
        KeycldError: no frame is given, or nothing is left to predict.
    """

    name: str
    split: str
    horizon: int
    given: int = 2
    factors: tuple[float, ...] = (1.0, 0.25)
    shown: int = 6

    def __post_init__(self):
        if not 1 <= self.given < self.horizon:
            raise KeycldError(
                f"protocol '{self.name}' gives {self.given} of {self.horizon} frames: "
                "give at least 1 and fewer than all."
            )


def _protocol(split: str, horizon: int, given: int, shown: int = 6) -> Protocol:
    """A protocol under its standard name, such as `test@50` or, with three given frames, `test@50-given-3`."""
    name = f"{split}@{horizon}" + ("" if given == 2 else f"-given-{given}")
    return Protocol(name, split, horizon, given=given, shown=shown)


def standard_protocols(given: int = 2) -> tuple[Protocol, ...]:
    """The standard protocols: the paper's, on unseen and on validation runs, and two longer horizons.

    Args:
        given: frames that the model sees: 2 (arXiv v1) or 3 (journal version).
    """
    return (
        _protocol("test", 50, given),
        _protocol("validation", 50, given),
        _protocol("test_long", 200, given, shown=3),
        _protocol("test_long", 500, given, shown=3),
    )


_GIVEN = {"keycld-2024": 3}
_NAMED = {protocol.name: protocol for given in (2, 3) for protocol in standard_protocols(given)}


def protocols_for(data: "DataSet", needed: int = 2) -> tuple[Protocol, ...]:
    """The standard protocols that the files of a data set allow; shorter recordings are scored to their end.

    Data made by the journal version's protocol give three frames, all others two.

    Args:
        data: the data set.
        needed: frames that the model starts from; as many are given where the data's protocol gives fewer.
    """
    found = {}
    given = max(needed, _GIVEN.get(str(data.attributes.get("protocol")), 2))
    for protocol in standard_protocols(given):
        if protocol.split in data.splits:
            horizon = min(protocol.horizon, data.split(protocol.split, images=False).frames)
            scored = _protocol(protocol.split, horizon, protocol.given)
            found[scored.name] = dataclasses.replace(protocol, name=scored.name, horizon=horizon)
    return tuple(found.values())


def protocol_named(name: str) -> Protocol:
    """The standard protocol of that name.

    Raises:
        KeycldError: there is none; names the nearest.
    """
    if name not in _NAMED:
        raise unknown("protocol", name, _NAMED)
    return _NAMED[name]
