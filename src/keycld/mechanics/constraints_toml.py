"""Constraints in a small TOML file next to the data.

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
point = [0.0, 0.0]        # or "unknown", or the name of an entry of the state's parameters
"""

import json
import tomllib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from keycld._errors import KeycldError, unknown
from keycld._files import read_text
from keycld.mechanics.constraints import Constraints
from keycld.mechanics.relation import AbstractRelation, relation_kinds, relation_of_kind

_MECHANISMS = "keycld.mechanics.mechanisms"


def load_constraints(path: str | Path) -> Constraints:
    """Read constraints from a TOML file laid out as at the top of this module; a file without any is fine.

    Args:
        path: the file, or the name of a mechanism such as "pendulum" (`mechanisms`).

    Raises:
        KeycldError: if the file cannot be read or says something else; it names the file, the entry and the fix. If
            there is neither such a file nor such a mechanism; it names the nearest mechanism.
    """
    if (name := str(path)) in mechanisms() and not Path(path).is_file():
        text = resources.files(_MECHANISMS).joinpath(f"{name}.toml").read_text(encoding="utf-8")
        return parse_constraints(text, f"the mechanism {name}")
    if not name:
        raise unknown("mechanism or constraints file", name, mechanisms())
    try:
        return parse_constraints(read_text(Path(path)), f"the constraints file {path}")
    except FileNotFoundError:
        if Path(path).suffix or len(Path(path).parts) > 1:
            raise KeycldError(f"there is no constraints file {path}: check the path.") from None
        raise unknown("mechanism or constraints file", name, mechanisms()) from None


def mechanisms() -> tuple[str, ...]:
    """Return the names of the mechanisms that are known by name: the TOML files of `keycld/mechanics/mechanisms/`."""
    files = (Path(file.name) for file in resources.files(_MECHANISMS).iterdir())
    return tuple(sorted(file.stem for file in files if file.suffix == ".toml"))


def parse_constraints(text: str, source: str) -> Constraints:
    """Parse constraints from TOML text as `load_constraints` reads it.

    Args:
        text: the TOML text.
        source: what error messages call it.

    Raises:
        KeycldError: as `load_constraints`.
    """
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise KeycldError(f"{source} is not valid TOML: {error}.") from None
    try:
        return _constraints(table)
    except KeycldError as error:
        raise KeycldError(f"in {source}: {error}") from None


def dump_constraints(constraints: Constraints) -> str:
    """Return the TOML text that `load_constraints` reads back to equal constraints.

    Raises:
        KeycldError: if one of them is a Python function, which has no text, or if they are measured by distances.
    """
    if not constraints.squared:
        raise KeycldError(
            "constraints measured by distances cannot be written as TOML, because a file names relations only: "
            "write the original ones and call distances() where the model is built."
        )
    lines = [f"keypoints = {_list(constraints.keypoints)}"]
    for item in constraints.items:
        lines += ["", "[[constraint]]", *_entry(item)]
    return "\n".join(lines) + "\n"


def _constraints(table: dict[str, Any]) -> Constraints:
    for key in table:
        if key not in ("keypoints", "constraint"):
            raise unknown("entry", key, ("keypoints", "constraint"))
    keypoints = table.get("keypoints")
    if not isinstance(keypoints, list) or len(keypoints) > 1000 or not all(isinstance(each, str) for each in keypoints):
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
        raise KeycldError(f"it needs a kind in quotes, one of {', '.join(sorted(relation_kinds()))}.")
    relation = relation_of_kind(kind)
    for name in entry:
        if name not in relation.required + relation.optional:
            raise unknown("entry", name, relation.required + relation.optional, of=f"a {kind} constraint")
    for name in relation.required:
        if name not in entry:
            raise KeycldError(f"a {kind} constraint needs the entry '{name}'.")
    try:
        return relation.read(entry)
    except KeycldError:
        raise
    except Exception as error:  # a class of someone else's raises anything
        raise KeycldError(
            f"{relation.__name__}.read cannot read this {kind} constraint ({type(error).__name__}: {error}): correct "
            "its entries, or that class."
        ) from error


def _entry(item: Any) -> list[str]:
    kinds = relation_kinds()
    if not isinstance(item, AbstractRelation) or kinds.get(item.kind) is not type(item):
        raise KeycldError(
            f"a {type(item).__name__} cannot be written as TOML: keep it in Python, or use the kinds "
            f"{', '.join(sorted(kinds))}."
        )
    return [f"{name} = {_toml(value)}" for name, value in ({"kind": item.kind} | item.write()).items()]


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    return _list(value)


def _list(values: Sequence[Any]) -> str:
    return "[" + ", ".join(map(_toml, values)) + "]"


def _text(value: str) -> str:
    # A JSON string is a TOML string, but for DEL, which TOML wants escaped.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
