"""The last step of making or importing data: what describes them, and the mark that they are finished."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from keycld._files import write_text
from keycld.data.describe.card import card
from keycld.data.describe.figures import sampled_figures
from keycld.data.describe.movies import PREVIEWED, write_preview
from keycld.data.describe.statistics import split_statistics
from keycld.data.format.derived import known, with_pictures
from keycld.data.format.folder import read_statistics, write_statistics
from keycld.data.format.reading import read
from keycld.data.format.trajectories import Trajectories
from keycld.systems import AbstractSampledSystem


def finish(folder: Path, made: dict[str, Any]) -> None:
    """Write `preview.gif`, `README.md` and, last, `statistics.json`, which holds `made` too."""
    names = sorted(path.stem for path in folder.glob("*.h5"))
    figures = {"splits": {name: split_statistics(folder / f"{name}.h5") for name in names}, **made}
    train = with_pictures(read(folder / "train.h5", rows=slice(0, PREVIEWED)))
    if isinstance(known(train), AbstractSampledSystem):
        figures |= sampled_figures(folder)
    write_preview(train, folder / "preview.gif")
    _write(folder, train, figures)


def describe_more(folder: Path, names: Sequence[str], seconds: float, frames: int) -> None:
    """Add files that were made later, in `seconds` with `frames` new pictures, to `README.md` and `statistics.json`.

    What these say of the other files stays, so a file that has changed since is still found.
    """
    figures = read_statistics(folder)
    assert figures is not None
    more = {name: split_statistics(folder / f"{name}.h5") for name in names}
    figures["splits"] = dict(sorted((figures["splits"] | more).items()))
    figures["seconds"] = round(figures.get("seconds", 0.0) + seconds, 1)
    figures["frames_drawn"] = figures.get("frames_drawn", 0) + frames
    _write(folder, with_pictures(read(folder / "train.h5", rows=slice(0, PREVIEWED))), figures)


def _write(folder: Path, train: Trajectories, figures: dict[str, Any]) -> None:
    write_text(folder / "README.md", card(train, figures))
    write_statistics(folder, figures)
