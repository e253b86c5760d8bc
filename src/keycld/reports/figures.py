"""Figures of a run from stored arrays."""

from typing import TYPE_CHECKING

import numpy as np

from keycld.drawing import (
    INK,
    Curve,
    Limit,
    curves_figure,
    histogram_figure,
    panels_figure,
)
from keycld.evaluation import METRICS, Evaluation, headline_vpt, threshold_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def error_figure(result: Evaluation) -> "Figure":
    """Plot the error over time with a band from 10th to 90th percentile, baselines and threshold (Fig. 3).

    The baseline "mean image" is left out, because its squared error is ε.
    """
    errors = _finite(result.errors)
    mean, frames = errors.mean(axis=0), np.arange(errors.shape[1])
    curves = [
        Curve(
            frames, mean, "this model",
            low=np.quantile(errors, 0.1, axis=0), high=np.quantile(errors, 0.9, axis=0),
        )
    ]  # fmt: skip
    colours = {"frozen frame": INK.two, "constant acceleration": INK.four}
    for name, colour in colours.items():
        if name not in result.scores["baselines"]:
            continue
        baseline = result.baseline_errors(name)
        curves.append(Curve(frames, baseline.mean(axis=0), name, colour, dashed=True))
    metric = result.scores["metric"]
    limit = Limit(result.scores["threshold"], threshold_text(metric, next(iter(result.scores["vpt"]))))
    # ε is zero where nothing moves in the validation recordings; a logarithmic axis has no such place.
    limits = [limit] if limit.value > 0 else []
    figure = curves_figure(curves, "frame", METRICS[metric], limits=limits, logarithmic=True)
    # Given frames of a baseline may be exact; a logarithmic axis should not extend to them.
    if positive := [value for value in (*mean, limit.value) if value > 0]:
        figure.axes[0].set_ylim(bottom=0.3 * float(min(positive)))
    return figure


def vpt_figure(result: Evaluation) -> "Figure":
    """Plot the histogram of valid prediction times, with the means of the model and of the best baseline."""
    vpt = result.vpt
    first, stop = result.scores["part"]
    limits = [Limit(vpt["mean"], f"mean {vpt['mean']:.2f}", INK.text)]
    best, score = max(
        ((name, headline_vpt(each)["mean"]) for name, each in result.scores["baselines"].items()),
        key=lambda item: item[1],
    )
    limits.append(Limit(score, f"{best} {score:.2f}", INK.quiet))
    return histogram_figure(
        np.array(vpt["frames"]) / (stop - first),
        f"valid prediction time, fraction of {stop - first} frames",
        "trajectories",
        limits=limits,
    )


def coordinate_figure(result: Evaluation) -> "Figure":
    """Plot the error of each true position along the roll-out: median with a band from 10th to 90th percentile."""
    errors = result.arrays["coordinate_error"]
    frames = np.arange(errors.shape[1])
    panels = []
    for k, each in enumerate(result.scores["state"]["coordinates"]):
        low, middle, high = np.nanquantile(errors[..., k], (0.1, 0.5, 0.9), axis=0)
        panels.append((f"{each['name']}, {each['unit']}", [Curve(frames, middle, low=low, high=high)]))
    size = (5.4, 3.0) if len(panels) == 1 else (2.7, 2.8)
    return panels_figure(panels, "frame", columns=2, panel_size=size)


def energy_figure(result: Evaluation) -> "Figure":
    """Plot kinetic, potential and total energy along up to three roll-outs without input."""
    time = result.arrays["time"]
    panels = []
    for n in range(min(3, len(result.arrays["free_kinetic"]))):
        kinetic, potential = result.arrays["free_kinetic"][n], result.arrays["free_potential"][n]
        potential = potential - potential.min()
        curves = [
            Curve(time, kinetic, "kinetic energy T", INK.two),
            Curve(time, potential, "potential energy V", INK.one),
            Curve(time, kinetic + potential, "T + V", INK.text),
        ]
        panels.append((f"recording {n + 1}", curves))
    return panels_figure(panels, "seconds", columns=3, panel_size=(3.6, 2.5))


def deviation_figure(result: Evaluation) -> "Figure":
    """Plot the largest |Φ(x) − constants| of the stored roll-outs over time."""
    deviation = np.maximum(result.arrays["deviation"].max(axis=0), 1e-9)
    curve = Curve(result.arrays["time"], deviation)
    return curves_figure([curve], "seconds", "|Φ(x) − constant|", logarithmic=True, size=(5.4, 2.5))


def _finite(errors: np.ndarray) -> np.ndarray:
    """Return errors to plot: those of a diverged prediction become the largest finite error."""
    top = float(np.max(errors[np.isfinite(errors)], initial=1.0))
    return np.nan_to_num(errors, nan=top, posinf=top)


def times_valid(result: Evaluation) -> np.ndarray:
    """Return the VPT of each trajectory in frames."""
    return np.array(result.vpt["frames"])
