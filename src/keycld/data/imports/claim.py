"""The first step of an import: who holds a folder."""

from pathlib import Path

from keycld._errors import KeycldError
from keycld._files import make_folder
from keycld.data.format.folder import CONSTRAINTS, PARTIAL, read_statistics, refuse_foreign, unfinished


def refuse_used(folder: Path) -> None:
    """Refuse a folder that an import may not write into.

    Raises:
        KeycldError: it holds other data, or files of others that data would replace.
    """
    refuse_foreign(folder, ("README.md", "preview.gif", CONSTRAINTS))
    made = read_statistics(folder) is None and (folder / PARTIAL / "recipe.json").exists()  # written by `make_data`
    if made or (any(folder.glob("*.h5")) and not unfinished(folder)):
        raise KeycldError(f"{folder} already holds data: choose another folder, or delete it first.")


def claim(folder: Path) -> Path:
    """Make the folder of an import, or take over an interrupted one; return the place of its parts.

    Raises:
        KeycldError: as `refuse_used`.
    """
    refuse_used(folder)
    parts = folder / PARTIAL
    make_folder(parts)
    return parts
