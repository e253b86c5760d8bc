"""A log of a rig with encoders: a CSV table with time, joint positions and torques."""

import csv
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from keycld._errors import KeycldError, unknown
from keycld._files import read_text

_FEWEST = 20
# Share of the sampling interval by which a time may be off.
_UNEVEN = 0.25


class Log(NamedTuple):
    """A log at even times.

    Attributes:
        dt: seconds between samples.
        q: joint positions `[T, d]`: rad, or metres for slides.
        u: measured torques or forces `[T, l]`.
    """

    dt: float
    q: Float[np.ndarray, "T d"]
    u: Float[np.ndarray, "T l"]


def read_log(path: str | Path, positions: tuple[str, ...], inputs: tuple[str, ...], time: str = "time") -> Log:
    """Read a log.

    Args:
        path: a CSV file; its first line names the columns.
        positions: names of the columns with joint positions.
        inputs: those with torques or forces, held from each time to the next.
        time: that with the time in seconds.

    Raises:
        KeycldError: no such file or column, no CSV, a column named twice, a value that is no number, too few rows, or
            uneven times.
    """
    path = Path(path)
    try:
        rows = list(csv.reader(read_text(path).rstrip().splitlines()))
    except FileNotFoundError as error:
        raise KeycldError(f"there is no log {path}: check the path.") from error
    except csv.Error as error:
        raise KeycldError(
            f"{path} cannot be read as CSV ({error}): check the path, or export the log again."
        ) from error
    names = [name.strip() for name in rows[0]] if rows else []
    columns, wanted = [], (time, *positions, *inputs)
    if twice := next((name for name in wanted if wanted.count(name) > 1 or names.count(name) > 1), None):
        raise KeycldError(
            f"the column '{twice}' is named twice, in the first line of {path} or among the columns to read: name each "
            "column once."
        )
    for name in wanted:
        if name not in names:
            if len(names) == 1 and (other := re.search(r"[;\t]", names[0])):
                raise KeycldError(f"columns of {path} are separated by {other[0]!r}: separate them by commas.")
            raise unknown("column", name, names or ["none: the file is empty"], of=str(path))
        columns.append(names.index(name))
    if len(rows) - 1 < _FEWEST:
        raise KeycldError(f"{path} has {max(0, len(rows) - 1)} rows of numbers, but {_FEWEST} are the least.")
    table = np.array([[_number(row, c, names, line, path) for c in columns] for line, row in enumerate(rows[1:], 2)])
    steps = np.diff(table[:, 0])
    dt = float(np.median(steps))
    grid = table[0, 0] + np.linspace(0, table[-1, 0] - table[0, 0], len(table))
    worst = int(np.argmax(np.abs(table[:, 0] - grid)))
    if not dt > 0 or np.max(np.abs(steps - dt)) > _UNEVEN * dt or abs(table[worst, 0] - grid[worst]) > dt:
        odd = int(np.argmax(np.abs(steps - dt)))
        raise KeycldError(
            f"the times of {path} are uneven ({steps[odd]:.4g} s after line {odd + 2}, {dt:.4g} s as a rule): "
            "resample it at even times."
        )
    dt = float((table[-1, 0] - table[0, 0]) / (len(table) - 1))
    q, u = np.split(table[:, 1:], [len(positions)], axis=1)
    return Log(dt, q, u)


def _number(row: list[str], column: int, names: list[str], line: int, path: Path) -> float:
    text = row[column].strip() if column < len(row) else ""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise KeycldError(
            f"line {line} of {path} has {text or 'nothing'!r} in the column '{names[column]}', but must have a number: "
            "remove the rows without one at the ends, or fill them in."
        )
    return value
