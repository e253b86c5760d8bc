"""The first step of an import: who holds a folder."""

import shutil
from pathlib import Path

from keycld._errors import KeycldError
from keycld._files import make_folder
from keycld.data.format.folder import CONSTRAINTS, PARTIAL, read_statistics, refuse_foreign, unfinished


def claim(folder: Path) -> Path:
    """Make the folder of an import, or take over an interrupted one; return the place of its parts.

    Raises:
        KeycldError: it holds other data.
    """
    refuse_foreign(folder, ("README.md", CONSTRAINTS))
    parts = folder / PARTIAL
    if read_statistics(folder) is not None:  # an import that was killed after its last file left its parts
        shutil.rmtree(parts, ignore_errors=True)
    made = (parts / "recipe.json").exists()  # written by `make_data`
    if made or (any(folder.glob("*.h5")) and not unfinished(folder)):
        raise KeycldError(f"{folder} already holds data: choose another folder, or delete it first.")
    make_folder(parts)
    return parts
