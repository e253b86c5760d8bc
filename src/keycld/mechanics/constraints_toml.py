"""Constraints in a small TOML file beside the data.

keypoints = ["cart", "tip"]

[[constraint]]
kind = "on_line"
keypoint = "cart"
direction = [1.0, 0.0]

[[constraint]]
kind = "fixed_distance"
between = ["cart", "tip"]

[[constraint]]
kind = "distance_to_point"
keypoint = "tip"
point = [0.0, 0.0]        # or the name of an entry of the state's parameters
"""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from keycld._errors import KeycldError, unknown
from keycld.mechanics.constraints import Constraints
from keycld.mechanics.relations import AbstractRelation, DistanceToPoint, FixedDistance, OnLine


def _between(value: Any) -> tuple[str, str]:
    if not isinstance(value, list) or len(value) != 2 or not all(isinstance(name, str) for name in value):
        raise KeycldError(f'\'between\' is two keypoints such as ["cart", "tip"], not {value!r}.')
    return value[0], value[1]


def _keypoint(value: Any) -> str:
    if not isinstance(value, str):
        raise KeycldError(f"'keypoint' is a name in quotes, not {value!r}.")
    return value


# By kind: what its entries are called, which of them may be left out, and how they become a relation.
_KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...], Callable[..., AbstractRelation]]] = {
    "fixed_distance": (("between",), (), lambda between: FixedDistance(*_between(between))),
    "distance_to_point": (
        ("keypoint", "point"),
        ("point",),
        lambda keypoint, point=(0.0, 0.0): DistanceToPoint(_keypoint(keypoint), point),
    ),
    "on_line": (
        ("keypoint", "direction"),
        ("direction",),
        lambda keypoint, direction=(1.0, 0.0): OnLine(_keypoint(keypoint), direction),
    ),
}


def load_constraints(path: str | Path) -> Constraints:
    """Read constraints from a TOML file laid out as at the top of this module; a file without any is fine.

    Raises:
        KeycldError: if the file cannot be read or says something else; it names the file, the entry, the mend.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise KeycldError(f"there is no constraints file {path}: check the path.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise KeycldError(f"the constraints file {path} cannot be read as text: {error}.") from None
    return parse_constraints(text, f"the constraints file {path}")


def parse_constraints(text: str, source: str) -> Constraints:
    """Constraints from TOML text as `load_constraints` reads it; errors call it `source`."""
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise KeycldError(f"{source} is not valid TOML: {error}.") from None
    try:
        return _constraints(table)
    except KeycldError as error:
        raise KeycldError(f"in {source}: {error}") from None


def dump_constraints(constraints: Constraints) -> str:
    """The TOML text that `load_constraints` reads back to equal constraints.

    Raises:
        KeycldError: if one of them is a Python function, which has no text.
    """
    lines = [f"keypoints = {_list(constraints.keypoints)}"]
    for item in constraints.items:
        lines += ["", "[[constraint]]", *_entry(item)]
    return "\n".join(lines) + "\n"


def _constraints(table: dict[str, Any]) -> Constraints:
    for key in table:
        if key not in ("keypoints", "constraint"):
            raise unknown("entry", key, ("keypoints", "constraint"))
    keypoints = table.get("keypoints")
    if not isinstance(keypoints, list):
        raise KeycldError('it needs the names of the keypoints, such as keypoints = ["cart", "tip"].')
    entries = table.get("constraint", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise KeycldError("constraints are tables: begin each with [[constraint]].")
    relations = []
    for number, entry in enumerate(entries, 1):
        try:
            relations.append(_relation(entry))
            Constraints(keypoints, relations)  # its names, while the number is known
        except KeycldError as error:
            raise KeycldError(f"constraint {number}: {error}") from None
    return Constraints(keypoints, relations)


def _relation(entry: dict[str, Any]) -> AbstractRelation:
    entry = dict(entry)
    kind = entry.pop("kind", None)
    if not isinstance(kind, str):
        raise KeycldError(f"it needs a kind in quotes, one of {', '.join(sorted(_KINDS))}.")
    if kind not in _KINDS:
        raise unknown("kind of constraint", kind, _KINDS)
    names, optional, build = _KINDS[kind]
    for name in entry:
        if name not in names:
            raise unknown(f"entry of a {kind} constraint", name, names)
    for name in names:
        if name not in entry and name not in optional:
            raise KeycldError(f"a {kind} constraint needs the entry '{name}'.")
    return build(**entry)


def _entry(item: Any) -> list[str]:
    match item:
        case FixedDistance(first=first, second=second):
            return ['kind = "fixed_distance"', f"between = {_list((first, second))}"]
        case DistanceToPoint(keypoint=keypoint, point=point):
            value = _text(point) if isinstance(point, str) else _list(point)
            return ['kind = "distance_to_point"', f"keypoint = {_text(keypoint)}", f"point = {value}"]
        case OnLine(keypoint=keypoint, direction=direction):
            return ['kind = "on_line"', f"keypoint = {_text(keypoint)}", f"direction = {_list(direction)}"]
    raise KeycldError(
        f"a {type(item).__name__} cannot be written as TOML: keep it in Python, or use the kinds "
        f"{', '.join(sorted(_KINDS))}."
    )


def _list(values: tuple[str | float, ...]) -> str:
    return "[" + ", ".join(_text(v) if isinstance(v, str) else repr(v) for v in values) + "]"


def _text(value: str) -> str:
    # A JSON string is a TOML string, but for DEL, which TOML wants escaped.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
