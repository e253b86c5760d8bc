"""The folder of a data set: names in it, whether it is finished, its statistics and check-sums."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NotRequired, TypedDict

from keycld._errors import KeycldError
from keycld._files import remove_orphans, write_text
from keycld._records import Name, read_json

PARTIAL = ".partial"
CONSTRAINTS = "constraints.toml"
_STATISTICS = "statistics.json"


class SplitPlan(TypedDict):
    """A split in a recipe: its name, the first seed and the one after the last, and the frames of a recording."""

    name: Name
    seeds: tuple[int, int]
    frames: int
    conditions: dict[str, Any]


class Recipe(TypedDict):
    """What decides the contents of a data set."""

    system: str
    protocol: NotRequired[str]
    splits: list[SplitPlan]


class SplitFigures(TypedDict):
    """The figures of one file; those of pictures are absent where there are none."""

    trajectories: int
    frames: int
    bytes: int
    sha256: str
    epsilon: NotRequired[float]


class _Statistics(TypedDict):
    splits: dict[Name, SplitFigures]
    recipe: NotRequired[Recipe]
    renderer: NotRequired[str]
    seconds: NotRequired[float]
    frames_drawn: NotRequired[int]
    parameters: NotRequired[dict[str, dict[str, float]]]
    conserved: NotRequired[dict[str, float]]
    baselines: NotRequired[dict[str, dict[str, float]]]


def refuse_foreign(folder: Path, names: Sequence[str]) -> None:
    """Refuse a folder without data in which files with these names would be replaced.

    Raises:
        KeycldError: there is one of them.
    """
    ours = (PARTIAL, _STATISTICS)
    if any((folder / name).exists() for name in ours) or any(folder.glob("*.h5")):
        return
    for name in names:
        if (folder / name).exists():
            raise KeycldError(f"{folder} holds a {name} that data would replace: choose another folder.")


def unfinished(folder: Path) -> bool:
    """Tell whether the making of the data in a folder was interrupted."""
    return (folder / PARTIAL).exists() and not (folder / _STATISTICS).exists()


def finished(folder: Path) -> bool:
    """Tell whether a folder holds finished data; hidden files of a maker that was killed after its last one go."""
    if unfinished(folder) or not (folder / "train.h5").exists():
        return False
    remove_orphans(folder)
    return True


def sha256(path: Path) -> str:
    """Compute the check-sum of a file, in hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_statistics(folder: Path) -> dict[str, Any] | None:
    """Read `statistics.json` of a folder; None if there is none.

    Raises:
        KeycldError: the file is damaged.
    """
    path = folder / _STATISTICS
    try:
        return read_json(path, _Statistics, "delete it and make the data again")
    except FileNotFoundError:
        return None


def read_recipe(path: Path) -> dict[str, Any] | None:
    """Read the recipe of unfinished work; None if there is none.

    Raises:
        KeycldError: the file is damaged.
    """
    try:
        return read_json(path, Recipe, "delete the folder that it is in")
    except FileNotFoundError:
        return None


def write_statistics(folder: Path, figures: dict[str, Any]) -> None:
    """Write `statistics.json`, which marks the folder as finished."""
    write_text(folder / _STATISTICS, json.dumps(figures, indent=1) + "\n")
