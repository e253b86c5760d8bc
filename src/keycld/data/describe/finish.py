"""The first step of importing, and the last one of making or importing: who holds a folder, and that it is finished."""

from pathlib import Path
from typing import Any

from keycld._errors import KeycldError
from keycld._files import make_folder, write_text
from keycld.data.card import card
from keycld.data.dataset import PARTIAL, unfinished
from keycld.data.drawn import known, with_pictures
from keycld.data.movies import PREVIEWED, write_preview
from keycld.data.sampled_figures import sampled_figures
from keycld.data.statistics import split_statistics, write_statistics
from keycld.data.store import read
from keycld.systems import AbstractSampledSystem


def claim(folder: Path) -> Path:
    """Make the folder of an import, or take up an interrupted one; returns the place of its parts.

    Raises:
        KeycldError: it holds other data.
    """
    parts = folder / PARTIAL
    made = (parts / "recipe.json").exists()  # `make_data` began it
    if made or (any(folder.glob("*.h5")) and not unfinished(folder)):
        raise KeycldError(f"{folder} already holds data: choose another folder, or delete it first.")
    make_folder(parts)
    return parts


def finish(folder: Path, made: dict[str, Any]) -> None:
    """Write `preview.gif`, `README.md` and, last, `statistics.json`, which holds `made` too."""
    names = sorted(path.stem for path in folder.glob("*.h5"))
    figures = {"splits": {name: split_statistics(folder / f"{name}.h5") for name in names}, **made}
    train = with_pictures(read(folder / "train.h5", rows=slice(0, PREVIEWED)))
    if isinstance(known(train), AbstractSampledSystem):
        figures |= sampled_figures(folder)
    write_preview(train, folder / "preview.gif")
    write_text(folder / "README.md", card(train, figures))
    write_statistics(folder, figures)
