"""The folder of a data set: names in it, whether it is finished, its statistics and check-sums."""

import hashlib
import json
from pathlib import Path
from typing import Any

from keycld._errors import KeycldError
from keycld._files import write_text

PARTIAL = ".partial"
CONSTRAINTS = "constraints.toml"
_STATISTICS = "statistics.json"


def unfinished(folder: Path) -> bool:
    """Tell whether the making of the data in a folder was interrupted."""
    return (folder / PARTIAL).exists() and not (folder / _STATISTICS).exists()


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
        return json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise KeycldError(f"{path} is damaged ({error}): delete it and make the data again.") from error


def write_statistics(folder: Path, figures: dict[str, Any]) -> None:
    """Write `statistics.json`, which marks the folder as finished."""
    write_text(folder / _STATISTICS, json.dumps(figures, indent=1) + "\n")
