"""Protocols by name: `test@50`, `test@256-priors-backward`, `test_long@50-from-30`.

A name is `FILE@FRAMES[-priors][-given-N][-from-K][-of-M][-backward]`:

- FILE.h5 is scored over windows of FRAMES frames;
- `priors`: as in "Which priors matter?", else as in the KeyCLD paper;
- `given-N`: N given frames instead of 5 (priors) or 2;
- `from-K`: recordings are taken up at frame K;
- `of-M`: the first M trajectories instead of 20 (priors) or all;
- `backward`: the last frames are given.
"""

import dataclasses
import re
from typing import TYPE_CHECKING

from keycld._errors import unknown
from keycld.data.describe.normalised_error import THRESHOLD
from keycld.evaluation.protocols import Protocol

if TYPE_CHECKING:
    from keycld.data import DataSet
    from keycld.models.base import AbstractModel

_NAME = re.compile(r"(\w+)@(\d+)(-priors)?(?:-given-(\d+))?(?:-from-(\d+))?(?:-of-(\d+))?(-backward)?", re.ASCII)
_KEYCLD_GIVEN, _PRIORS_GIVEN = 2, 5
_PRIORS_TRAJECTORIES = 20


def make_protocol(
    split: str,
    horizon: int,
    *,
    priors: bool = False,
    given: int | None = None,
    start: int = 0,
    trajectories: int | None = None,
    backward: bool = False,
) -> Protocol:
    """Make a protocol of one of the two papers, under its standard name.

    Args:
        split: which file, without `.h5`.
        horizon: T, frames of the window.
        priors: as in "Which priors matter?": normalised error against 0.025, scored from frame 64 on (models are
            trained on 64), 20 trajectories. Else as in the KeyCLD paper: mean squared error against ε and ε/4, all
            frames of all trajectories.
        given: frames that the model gets; the paper's number by default.
        start: frame at which recordings are taken up.
        trajectories: how many, the first of the file; the paper's number by default.
        backward: predict the past from the last frames.

    Raises:
        KeycldError: the values make no sense together.
    """
    usual = _PRIORS_GIVEN if priors else _KEYCLD_GIVEN
    given = usual if given is None else given
    many = _PRIORS_TRAJECTORIES if priors else None
    trajectories = many if trajectories is None else trajectories
    words = [
        "priors" if priors else "",
        f"given-{given}" if given != usual else "",
        f"from-{start}" if start else "",
        f"of-{trajectories}" if trajectories != many else "",
        "backward" if backward else "",
    ]
    name = "-".join([f"{split}@{horizon}", *filter(None, words)])
    direction, shown = "backward" if backward else "forward", 6 if horizon <= 100 else 3
    if not priors:
        return Protocol(name, split, horizon, given, start, direction=direction, trajectories=trajectories, shown=shown)
    return Protocol(
        name,
        split,
        horizon,
        given,
        start,
        metric="normalised",
        thresholds=(THRESHOLD,),
        scored_from=64,
        direction=direction,
        trajectories=trajectories,
        shown=shown,
    )


def _table(*protocols: Protocol) -> dict[str, Protocol]:
    return {protocol.name: protocol for protocol in protocols}


KEYCLD_PROTOCOLS = _table(
    make_protocol("test", 50),
    make_protocol("validation", 50),
    make_protocol("test_long", 200),
    make_protocol("test_long", 500),
    make_protocol("test_long", 50, start=30),
)
"""What data are scored with by default: those of the KeyCLD paper, two longer horizons, and motions taken up."""

PRIORS_PROTOCOLS = _table(
    make_protocol("test", 256, priors=True),
    make_protocol("test", 256, priors=True, backward=True),
    make_protocol("test_long", 50, start=30),
)
"""What the data sets of "Which priors matter?" are scored with by default."""

PROTOCOLS = (
    KEYCLD_PROTOCOLS
    | _table(
        *(make_protocol(each.split, each.horizon, given=3) for each in KEYCLD_PROTOCOLS.values() if not each.start)
    )
    | _table(*(make_protocol("test_long", 50, start=start) for start in (2, 5, 10)))
    | PRIORS_PROTOCOLS
    | _table(make_protocol("test", 124, priors=True), make_protocol("test_long", 1000, priors=True))
)
"""The protocols with a name in `docs/evaluation.md`; the grammar makes more."""

# Data made by the journal version's split plan give three frames.
_GIVEN = {"keycld-2024": 3}


def protocol_named(name: str) -> Protocol:
    """Return the protocol of that name: one of `PROTOCOLS`, or another one of the same grammar.

    Raises:
        KeycldError: the name is none, with the nearest of `PROTOCOLS`; or its numbers make no sense.
    """
    found = _NAME.fullmatch(name)
    if found is None:
        raise unknown("protocol", name, PROTOCOLS, listed="docs/evaluation.md")
    split, horizon, priors, given, start, trajectories, backward = found.groups()
    return make_protocol(
        split,
        int(horizon),
        priors=priors is not None,
        given=None if given is None else int(given),
        start=int(start or 0),
        trajectories=None if trajectories is None else int(trajectories),
        backward=backward is not None,
    )


def protocols_for(data: "DataSet", model: "AbstractModel") -> tuple[Protocol, ...]:
    """Return the standard protocols that fit a data set and a model.

    Recordings shorter than a protocol's window are scored to their end. A model that needs more given frames gets them.
    Backward protocols are for a `Reversible` model only.
    """
    from keycld.models.base import Reversible

    plan = str(data.attributes.get("protocol"))
    table = PRIORS_PROTOCOLS if plan.startswith("priors") or plan == "published" else KEYCLD_PROTOCOLS
    found = {}
    for protocol in table.values():
        if protocol.split not in data.splits or (protocol.backward and not isinstance(model, Reversible)):
            continue
        frames = data.split(protocol.split, images=False, rows=slice(0, 1)).frames - protocol.start
        horizon = min(protocol.horizon, frames)
        given = max(protocol.given, model.context, _GIVEN.get(plan, 0))
        if horizon <= max(given, protocol.scored_from):
            continue
        fitting = with_given(dataclasses.replace(protocol, horizon=horizon), given)
        found[fitting.name] = fitting
    return tuple(found.values())


def with_given(protocol: Protocol, given: int) -> Protocol:
    """Return a standard protocol with another number of given frames, under its own name."""
    return make_protocol(
        protocol.split,
        protocol.horizon,
        priors=protocol.metric == "normalised",
        given=given,
        start=protocol.start,
        trajectories=protocol.trajectories,
        backward=protocol.backward,
    )
