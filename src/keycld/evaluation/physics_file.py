"""`evaluation/physics.json`: physical constants of a run with error bars, what was rejected, a prediction."""

from pathlib import Path
from typing import Any, NotRequired, TypedDict

from keycld._errors import KeycldError
from keycld._files import make_folder, write_text
from keycld._records import read_json
from keycld.evaluation.storage import as_json

PHYSICS = "physics"
"""Name of the result: `evaluation/physics.json`."""
# A positive constant with a larger relative error is not determined: its linear error bar means nothing.
_VAGUE = 0.5
# The relative error of a number that was given, such as a length: rounding.
_EXACT = 1e-9


class Constant(TypedDict):
    """One physical constant.

    Attributes:
        value: in `unit`; null where the recordings do not determine it.
        sigma: its standard error; null where the value is null, or exact.
        unit: such as "units", "s" or "1/s"; "units" are those of the image plane.
        identifiable: whether the recordings determine the value.
        note: one sentence on what the number rests on, or why there is none.
    """

    value: float | None
    sigma: float | None
    unit: str
    identifiable: bool
    note: NotRequired[str]


def constant(value: float, sigma: float, unit: str, *, positive: bool) -> Constant:
    """Return a measured constant; without a value if it is positive and its error is more than half of it."""
    if positive and sigma > _VAGUE * abs(value):
        return unknown_constant(unit, f"its standard error, {sigma:.2g}, is more than half of it")
    exact = sigma <= _EXACT * abs(value)
    return Constant(value=value, sigma=None if exact else sigma, unit=unit, identifiable=True)


def unknown_constant(unit: str, note: str) -> Constant:
    """Return a constant without a value, and why it has none."""
    return Constant(value=None, sigma=None, unit=unit, identifiable=False, note=note)


class Rejected(TypedDict):
    """Evidence against a force that was tried and dropped.

    Attributes:
        worth: share by which the cost of the fit rises without it.
        needed: the least share that a force must be worth.
    """

    worth: float
    needed: float


class MeasuredOn(TypedDict):
    """What the constants were fitted to.

    Attributes:
        pieces: how many recordings, or pieces of recordings.
        frames: of each.
        whole: whether they are whole recordings; pieces are taken where no motion of the law follows the whole.
    """

    pieces: int
    frames: int
    whole: bool


class Alternative(TypedDict):
    """A mechanism that a clip may show, with its evidence.

    Attributes:
        mechanism: its name, or null.
        keypoints: their names.
        constraints: each with its residual: how far the track deviates from it, as a share of the track's extent.
        freedom: degrees of freedom.
        prediction: error of the predicted validation part, as a share of the extent of the motion; null where it was
            not predicted, because the constraints do not hold.
        chosen: whether it is the answer.
    """

    mechanism: str | None
    keypoints: list[str]
    constraints: dict[str, float]
    freedom: int
    prediction: float | None
    chosen: bool


class Comparison(TypedDict):
    """The contents of `alternatives.json`.

    Attributes:
        alternatives: all mechanisms that were compared.
    """

    alternatives: list[Alternative]


class Physics(TypedDict):
    """The contents of `physics.json`.

    Attributes:
        mechanism: its name, or null where the constraints have none.
        fps: frames a second; all times are at this rate; null where there are none.
        constants: by name; the names are stable (docs/physics.md).
        rejected: forces that were tried and dropped, by kind.
        prediction: scores of a prediction that was not part of the fit, {} without one.
        measured_on: what the constants were fitted to; of older versions it is missing.
        given: what the user has measured, by the name of the constant.
        forces: kinds of forces that act in addition to gravity.
        alternatives: the mechanisms that were compared, the chosen one first, where none was told or none learned.
        note: why there is no mechanism, no model of it, or no prediction.
        changes: which seconds of a clip are used where not all are, and what was changed in its pictures.
    """

    mechanism: str | None
    fps: float | None
    constants: dict[str, Constant]
    rejected: dict[str, Rejected]
    prediction: dict[str, Any]
    measured_on: NotRequired[MeasuredOn]
    given: NotRequired[dict[str, float]]
    forces: NotRequired[list[str]]
    alternatives: NotRequired[list[Alternative]]
    note: NotRequired[str]
    changes: NotRequired[list[str]]


def save_physics(folder: str | Path, physics: Physics) -> Path:
    """Write `evaluation/physics.json` of a run folder and return its path."""
    path = Path(folder) / "evaluation" / f"{PHYSICS}.json"
    make_folder(path.parent)
    write_text(path, as_json(dict(physics)) + "\n")
    return path


def load_physics(folder: str | Path) -> Physics:
    """Read what `save_physics` wrote.

    Raises:
        KeycldError: it is missing or damaged.
    """
    path = Path(folder) / "evaluation" / f"{PHYSICS}.json"
    try:
        return read_json(path, Physics, "measure the physics again")
    except FileNotFoundError as error:
        raise KeycldError(f"no physical constants in '{folder}': measure them first (docs/physics.md).") from error


def pieces_note(physics: Physics) -> str:
    """Say that the constants are those of pieces of the recordings; "" if they are not."""
    on = physics.get("measured_on")
    if on is None or on["whole"]:
        return ""
    return (
        f"measured on {on['pieces']} pieces of {on['frames']} frames: no motion of the law follows the whole recordings"
    )
