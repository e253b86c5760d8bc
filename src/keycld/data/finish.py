"""The last step of making or importing: preview, card, and the statistics that mark a folder as finished."""

from pathlib import Path
from typing import Any

from keycld.data.atomic import write_text
from keycld.data.card import card
from keycld.data.drawn import known, with_pictures
from keycld.data.movies import PREVIEWED, write_preview
from keycld.data.sampled_figures import sampled_figures
from keycld.data.statistics import split_statistics, write_statistics
from keycld.data.store import read
from keycld.systems import AbstractSampledSystem


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
