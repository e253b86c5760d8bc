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


_PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        Protocol("test@50", "test", 50),
        Protocol("validation@50", "validation", 50),
        Protocol("test_long@200", "test_long", 200, shown=3),
        Protocol("test_long@500", "test_long", 500, shown=3),
    )
}


def standard_protocols() -> tuple[Protocol, ...]:
    """The standard protocols: the paper's, on unseen and on validation runs, and two longer horizons."""
    return tuple(_PROTOCOLS.values())


def protocols_for(data: "DataSet") -> tuple[Protocol, ...]:
    """The standard protocols that the files of a data set allow; shorter recordings are scored to their end."""
    found = {}
    for protocol in standard_protocols():
        if protocol.split in data.splits:
            horizon = min(protocol.horizon, data.split(protocol.split, images=False).frames)
            name = f"{protocol.split}@{horizon}"
            found[name] = dataclasses.replace(protocol, name=name, horizon=horizon)
    return tuple(found.values())


def protocol_named(name: str) -> Protocol:
    """The standard protocol of that name.

    Raises:
        KeycldError: there is none; names the nearest.
    """
    if name not in _PROTOCOLS:
        raise unknown("protocol", name, _PROTOCOLS)
    return _PROTOCOLS[name]
