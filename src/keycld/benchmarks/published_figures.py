"""The KeyCLD paper's Figs. 1, 5 and 8 to 12 for each data set, from run folders' stored evaluations alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from keycld._errors import KeycldError
from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.run_figures import control_strip, observation_sheet, potential_figures
from keycld.benchmarks.table import data_labels, done_results
from keycld.drawing import save_figure, save_image
from keycld.evaluation import Evaluation, load_evaluation

_MODEL = "keycld"
"""These figures show the paper's own model, not its ablations."""
_LAWS = ("paper", "shaping", "mpc")
"""The closed loop of Fig. 5: under eq. (15) where it is stored, otherwise under another law."""
_POTENTIAL = {
    ("pendulum", "rotation"): 8,
    ("cartpole", "pole"): 9,
    ("cartpole", "cart"): 10,
    ("acrobot", "shoulder"): 11,
    ("acrobot", "elbow"): 12,
}
"""Number of the paper's figure, by system and name of the sweep."""


@dataclass(frozen=True)
class PaperFigure:
    """A figure of the paper, made anew.

    Attributes:
        path: PNG.
        title: number in the paper, data set, and what it shows.
    """

    path: Path
    title: str


@dataclass(frozen=True)
class PaperFigures:
    """The figures that could be made, and one sentence for each that could not.

    Attributes:
        made: in the paper's order.
        left_out: which figure, why, and the command that makes what it needs.
    """

    made: tuple[PaperFigure, ...]
    left_out: tuple[str, ...]


@dataclass(frozen=True)
class _Trained:
    """A run folder with a trained KeyCLD model, and the data that it was trained on."""

    experiment: Experiment
    run: Path

    @property
    def label(self) -> str:
        return self.experiment.data.label


def paper_figures(experiments: Sequence[Experiment], place: Place, folder: Path) -> PaperFigures:
    """Write Fig. 1 for all data sets together, Fig. 5 and Figs. 8 to 12 for each one.

    Each data set is shown with the first seed that has a run folder: not chosen by its score.

    Args:
        experiments: of one suite; only those that are done and train KeyCLD are shown.
        place: where their results and run folders are.
        folder: of the PNG files.

    Raises:
        KeycldError: a file cannot be written.
    """
    left_out = []
    trained = {}
    for experiment, _ in done_results(experiments, place):
        run = place.run(experiment)
        if experiment.model == _MODEL and (run / "evaluation").is_dir():
            trained.setdefault(experiment.data.label, _Trained(experiment, run))
    for label in data_labels(experiments):
        if label not in trained:
            left_out.append(
                f"Figs. 1, 5 and 8 to 12 leave out {label}: no experiment with {_MODEL} is done and has a run folder; "
                f"`keycld bench run {experiments[0].suite} --models {_MODEL}` makes one."
            )
    shown = [trained[label] for label in data_labels(experiments) if label in trained]
    parts = (_observations(shown, folder, left_out), _closed_loops(shown, folder, left_out))
    return PaperFigures((*parts[0], *parts[1], *_potentials(shown, folder, left_out)), tuple(left_out))


def _observations(shown: Sequence[_Trained], folder: Path, left_out: list[str]) -> list[PaperFigure]:
    """Write Fig. 1: a frame, its heat maps, its keypoints and the rendered picture, one data set a row."""
    rows = []
    for each in shown:
        # The first protocol is the suite's headline: unseen recordings.
        result = _stored(each, each.experiment.protocols[0].name, "Fig. 1", left_out)
        if result is not None:
            rows.append((each.label, result, 0))
    if not rows:
        return []
    path = folder / "fig-1.png"
    save_image(path, observation_sheet(rows))
    return [PaperFigure(path, "Fig. 1: from a picture to keypoints and back")]


def _closed_loops(shown: Sequence[_Trained], folder: Path, left_out: list[str]) -> list[PaperFigure]:
    """Write Fig. 5: pictures of a swing-up from pixels."""
    made = []
    for each in shown:
        # The shortest name is the run with the law's default settings.
        names = [
            min(names, key=len)
            for law in _LAWS
            if (names := [path.stem for path in (each.run / "evaluation").glob(f"control-upright-{law}*.json")])
        ]
        if not names:
            left_out.append(
                f"Fig. 5 leaves out {each.label}: no closed-loop run is stored; `keycld control {each.run} --law "
                f"{_LAWS[0]}` makes one."
            )
            continue
        result = _stored(each, names[0], "Fig. 5", left_out)
        if result is not None:
            path = folder / f"fig-5-{each.label}.png"
            save_image(path, control_strip(result))
            made.append(PaperFigure(path, f"Fig. 5: {each.label}, control law {result.scores['law']}"))
    return made


def _potentials(shown: Sequence[_Trained], folder: Path, left_out: list[str]) -> list[PaperFigure]:
    """Write Figs. 8 to 12: V along paths; and V over the grids of two coordinates, which the paper does not show."""
    made = []
    for each in shown:
        sweeps = _stored(each, "sweeps", "Figs. 8 to 12", left_out)
        if sweeps is None or not sweeps.arrays:
            continue
        for name, vary, figure in potential_figures(sweeps.arrays):
            number = _POTENTIAL.get((each.experiment.data.system, name))
            path = folder / f"{'potential' if number is None else f'fig-{number}'}-{each.label}-{name}.png"
            save_figure(path, figure)
            what = f"{each.label}, potential energy over {' and '.join(vary)}"
            made.append(PaperFigure(path, what if number is None else f"Fig. {number}: {what}"))
    return made


def _stored(each: _Trained, name: str, figure: str, left_out: list[str]) -> Evaluation | None:
    try:
        return load_evaluation(each.run, name)
    except KeycldError as error:
        left_out.append(f"{figure} leaves out {each.label}: {error}")
        return None
