"""Write the figures, sheets and movies of a suite as files."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from keycld._errors import KeycldError
from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.figures import error_figure
from keycld.benchmarks.pictures import Gallery, frames_per_second, gallery, movie_of, sheet_of
from keycld.benchmarks.published_figures import PaperFigures, paper_figures
from keycld.benchmarks.status import count_states
from keycld.benchmarks.table import data_labels
from keycld.drawing import save_figure, save_image, save_movie
from keycld.evaluation import Protocol


@dataclass(frozen=True)
class Illustration:
    """Sheet and movie of one data set under one protocol.

    Attributes:
        gallery: the frames that they show.
        protocol: how these were predicted.
        sheet: PNG, the layout of the paper's Figs. 13 to 15.
        movie: MP4, all models side by side. `movie.with_suffix(".gif")` is the same, smaller.
    """

    gallery: Gallery
    protocol: Protocol
    sheet: Path
    movie: Path

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that was written."""
        return self.sheet, self.movie, self.movie.with_suffix(".gif")


@dataclass(frozen=True)
class Illustrations:
    """All figures, sheets and movies of a suite.

    Attributes:
        errors: PNG of the error over time (Fig. 3), by the protocol's name.
        paper: what the trained KeyCLD models have learned (Figs. 1, 5 and 8 to 12).
        pictures: of each data set whose run folders are there (Figs. 4 and 13 to 15).
    """

    errors: dict[str, Path]
    paper: PaperFigures
    pictures: tuple[Illustration, ...]

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that was written."""
        moving = [path for each in self.pictures for path in each.files]
        return (*self.errors.values(), *(figure.path for figure in self.paper.made), *moving)


def illustrate(experiments: Sequence[Experiment], place: Place, folder: Path) -> Illustrations:
    """Write Fig. 3 from the results, and all other figures, sheets and movies from the run folders that are there.

    Sheets and movies show the first recording of the test set and, over the shorter of the long horizons, that of the
    long test.

    Raises:
        KeycldError: no experiment is done.
    """
    protocols = experiments[0].protocols
    errors = {}
    for protocol in protocols:
        figure = error_figure(experiments, place, protocol)
        if figure is None:
            stale = count_states(experiments, place).get("stale", 0)
            also = f" ({stale} are of other settings, data or protocols)" if stale else ""
            raise KeycldError(
                f"none of these experiments is done{also}, so there is nothing to plot: keycld bench run."
            )
        errors[protocol.name] = folder / f"error-{protocol.name}.png"
        save_figure(errors[protocol.name], figure)
    pictures = []
    shown = {protocol.split: protocol for protocol in reversed(protocols) if protocol.split.startswith("test")}
    for protocol in reversed(shown.values()):
        for label in data_labels(experiments):
            found = gallery(experiments, place, label, protocol)
            if found is not None:
                pictures.append(save_illustration(found, protocol, folder))
    return Illustrations(errors, paper_figures(experiments, place, folder), tuple(pictures))


def save_illustration(found: Gallery, protocol: Protocol, folder: Path) -> Illustration:
    """Write sheet and movie of some frames, and return where they are."""
    name = f"{found.label.replace('/', '-')}-{protocol.name}"
    saved = Illustration(found, protocol, folder / f"sheet-{name}.png", folder / f"movie-{name}.mp4")
    # As many columns as the paper's: every fourth of 50 frames.
    every = max(1, round(4 * len(found.truth) / 50))
    save_image(saved.sheet, sheet_of(found, every))
    fps = frames_per_second(found)
    save_movie(saved.movie, movie_of(found), fps, scale=1)
    save_movie(saved.movie.with_suffix(".gif"), movie_of(found, scale=2), fps, scale=1)
    return saved
