"""Fig. 3 of arXiv v1 from recorded results: error over time of all models, one panel for each data set."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.suites import MODEL_TITLES, model_order, model_title
from keycld.benchmarks.table import data_labels, done_results
from keycld.drawing import INK, Curve, Limit, panels_figure
from keycld.evaluation import METRICS, Protocol, threshold_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# A model has the same colour in all figures, even if other models are missing.
_COLOURS = dict(zip(MODEL_TITLES, INK.cycle, strict=False))


def error_figure(experiments: Sequence[Experiment], place: Place, protocol: Protocol) -> "Figure | None":
    """Plot the error over time, one curve for each model, with the headline threshold dashed.

    A curve is the mean over trajectories and then over seeds; its band goes from the 10th to the 90th percentile of the
    trajectories, each percentile a mean over seeds. The paper shows 20 validation recordings of one seed.

    Args:
        experiments: of one suite.
        place: where their results are.
        protocol: which of their scores.

    Returns:
        the figure, None if there is no result.
    """
    # A model that cannot run backward has no such score.
    results = [each for each in done_results(experiments, place) if protocol.name in each[1]["curves"]]
    labels = [label for label in data_labels(experiments) if any(each.data.label == label for each, _ in results)]
    if not labels:
        return None
    models = model_order(each.model for each, _ in results)
    panels, limits = [], []
    for label in labels:
        here = [(each.model, result) for each, result in results if each.data.label == label]
        curves = [
            _curve(model, [result["curves"][protocol.name] for trained, result in here if trained == model])
            for model in models
        ]
        # The legend is that of the first panel, so all models are in it, even without a result there.
        panels.append((label, curves))
        threshold = protocol.limit(protocol.thresholds[0], here[0][1]["scores"][protocol.name]["epsilon"])
        limits.append(Limit(threshold, threshold_text(protocol.metric, f"{protocol.thresholds[0]:g}")))
    figure = panels_figure(
        panels,
        "frame",
        y_label=METRICS[protocol.metric],
        columns=3 if len(labels) <= 3 else 4,
        logarithmic=True,
        limits=limits,
        panel_size=(3.6, 2.6),
    )
    for axes, (_, curves) in zip(figure.axes, panels, strict=False):
        values = np.concatenate([curve.y[curve.y > 0] for curve in curves])
        # The errors of given frames may be almost zero; a logarithmic axis should not extend to them.
        if values.size:
            axes.set_ylim(bottom=0.3 * float(values.min()), top=3.0 * float(values.max()))
    return figure


def _curve(model: str, stored: Sequence[dict[str, Any]]) -> Curve:
    title, colour = model_title(model), _COLOURS.get(model, INK.cycle[-1])
    if not stored:
        return Curve(np.array([0.0]), np.array([np.nan]), title, colour)
    mean, low, high = (np.mean([each[name] for each in stored], axis=0) for name in ("mean", "low", "high"))
    return Curve(np.asarray(stored[0]["frame"]), mean, title, colour, low=low, high=high)
