"""Figures of the suite `priors`: frame sheets, roll-outs as movies, cost against score."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from keycld._errors import KeycldError
from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.illustrations import Illustration, save_illustration
from keycld.benchmarks.pictures import gallery
from keycld.benchmarks.suites import model_title
from keycld.benchmarks.table import data_labels, done_results
from keycld.drawing import Curve, panels_figure, save_figure
from keycld.evaluation import Protocol, headline_vpt


def cost_figure(experiments: Sequence[Experiment], place: Place) -> Figure | None:
    """Plot forward VPT against minutes of training, a panel for each model and a point for each set and seed.

    Args:
        experiments: of one suite; the score is that of the first protocol.
        place: where their results are.

    Returns:
        the figure, None if there is no result.
    """
    points: dict[str, list[tuple[float, float]]] = {}
    for experiment, result in done_results(experiments, place):
        score = headline_vpt(result["scores"][experiment.protocols[0].name])["mean"]
        points.setdefault(experiment.model, []).append((result["training"]["seconds"] / 60.0, score))
    panels = []
    for model, found in points.items():
        minutes, scores = np.array(sorted(found)).T
        panels.append((model_title(model), [Curve(minutes, scores, points=True)]))
    if not panels:
        return None
    return panels_figure(panels, "minutes of training", y_label="VPT forward", columns=4)


def shown_protocols(experiments: Sequence[Experiment]) -> tuple[Protocol, ...]:
    """Return the protocols whose roll-outs are shown: 20 trajectories of 256 frames, forward and backward."""
    found = {protocol.name: protocol for each in experiments for protocol in each.protocols}
    return tuple(each for each in found.values() if each.trajectories == 20 and each.horizon == 256)


def illustrate_priors(experiments: Sequence[Experiment], place: Place, folder: Path) -> tuple[Path, ...]:
    """Write the cost figure, and a frame sheet and a movie of each set and direction whose run folders are there.

    They show the first trajectory of the test set.

    Raises:
        KeycldError: no experiment is done.
    """
    figure = cost_figure(experiments, place)
    if figure is None:
        raise KeycldError("none of these experiments is done, so there is nothing to plot: keycld bench run.")
    written = [folder / "cost.png"]
    save_figure(written[0], figure)
    for protocol in shown_protocols(experiments):
        for label in data_labels(experiments):
            found = gallery(experiments, place, label, protocol)
            if found is not None:
                saved: Illustration = save_illustration(found, protocol, folder)
                written += saved.files
    return tuple(written)
