"""The last step of making or importing data: what describes them, and the mark that they are finished."""

from pathlib import Path
from typing import Any

from keycld._files import write_text
from keycld.data.describe.card import card
from keycld.data.describe.figures import sampled_figures
from keycld.data.describe.movies import PREVIEWED, write_preview
from keycld.data.describe.statistics import split_statistics
from keycld.data.format.derived import known, with_pictures
from keycld.data.format.folder import write_statistics
from keycld.data.format.reading import read
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
