"""Figures of a run from stored arrays."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from keycld.drawing import (
    INK,
    Curve,
    Limit,
    curves_figure,
    histogram_figure,
    map_figure,
    overlay_keypoints,
    panels_figure,
    sheet,
    strip_figure,
)
from keycld.evaluation import METRICS, Evaluation, headline_vpt, threshold_text


def error_figure(result: Evaluation) -> Figure:
    """Plot the error over time with a band from 10th to 90th percentile, baselines and threshold (Fig. 3).

    The baseline "mean image" is left out, because its squared error is ε.
    """
    errors = _finite(result.errors)
    frames = np.arange(errors.shape[1])
    curves = [
        Curve(
            frames, errors.mean(axis=0), "this model",
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
    figure = curves_figure(curves, "frame", METRICS[metric], limits=[limit], logarithmic=True)
    # Given frames of a baseline may be exact; a logarithmic axis should not extend to them.
    floor = 0.3 * min(float(curve.y[curve.y > 0].min()) for curve in curves[:1])
    figure.axes[0].set_ylim(bottom=floor)
    return figure


def vpt_figure(result: Evaluation) -> Figure:
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


def coordinate_figure(result: Evaluation) -> Figure:
    """Plot the error of each true position along the roll-out: median with a band from 10th to 90th percentile."""
    errors = result.arrays["coordinate_error"]
    frames = np.arange(errors.shape[1])
    panels = []
    for k, each in enumerate(result.scores["state"]["coordinates"]):
        low, middle, high = np.nanquantile(errors[..., k], (0.1, 0.5, 0.9), axis=0)
        panels.append((f"{each['name']}, {each['unit']}", [Curve(frames, middle, low=low, high=high)]))
    size = (5.4, 3.0) if len(panels) == 1 else (2.7, 2.8)
    return panels_figure(panels, "frame", columns=2, panel_size=size)


def energy_figure(result: Evaluation) -> Figure:
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


def deviation_figure(result: Evaluation) -> Figure:
    """Plot the largest |Φ(x) − constants| of the stored roll-outs over time."""
    deviation = np.maximum(result.arrays["deviation"].max(axis=0), 1e-9)
    curve = Curve(result.arrays["time"], deviation)
    return curves_figure([curve], "seconds", "|Φ(x) − constant|", logarithmic=True, size=(5.4, 2.5))


def grid_pictures(sweeps: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """Every other picture of a two-dimensional grid, laid out like the map of V: the first row is the lowest."""
    rows, columns = sweeps[f"{name}/shape"]
    image = sweeps[f"{name}/image"].reshape(rows, columns, *sweeps[f"{name}/image"].shape[1:])
    return sheet(list(image[::2, ::2][::-1]), every=1)


def sweep_figures(sweeps: Mapping[str, np.ndarray]) -> list[tuple[str, str, Figure]]:
    """V along each path with pictures above it, and over each two-dimensional grid: name, what varies,
    figure.

    All paths share one vertical span, so that a coordinate on which V hardly depends shows as a flat line.
    """
    kinds = list(zip(sweeps["names"], sweeps["vary"], sweeps["units"], strict=True))
    paths = [kind for kind in kinds if "," not in kind[1] and kind[0] != "grid"]
    span = max((float(np.ptp(sweeps[f"{name}/potential"])) for name, _, _ in paths), default=1.0)
    found = []
    for name, vary, units in kinds:
        potential = sweeps[f"{name}/potential"]
        values, labels = _in_degrees(sweeps[f"{name}/values"], vary.split(","), units.split(","))
        if "," in vary:
            rows, columns = sweeps[f"{name}/shape"]
            table = (potential - potential.min()).reshape(rows, columns)
            axes = values.reshape(rows, columns, 2)
            down, right = (90.0 if label.endswith("degrees") else None for label in labels)
            figure = map_figure(
                table, axes[0, :, 1], axes[:, 0, 0], labels[1], labels[0], "potential energy V", spacings=(right, down)
            )
        elif name == "grid":
            continue  # the same path again, with fewer points
        else:
            figure = _path_figure(sweeps, name, values[:, 0], labels[0], span)
        found.append((str(name), str(vary), figure))
    return found


def _path_figure(sweeps: Mapping[str, np.ndarray], name: str, values: np.ndarray, label: str, span: float) -> Figure:
    picked = np.round(np.linspace(0, len(values) - 1, 9)).astype(int)
    keypoints = sweeps[f"{name}/keypoints"][picked]
    pictures = overlay_keypoints(sweeps[f"{name}/image"][picked], keypoints, scale=3)
    potential = sweeps[f"{name}/potential"]
    middle = 0.5 * (potential.max() + potential.min())
    curve = Curve(values, potential - middle)
    limits = (-0.58 * span, 0.58 * span)
    spacing = 45.0 if label.endswith("degrees") else None
    return strip_figure(
        [curve], pictures, label, "potential energy V", y_limits=limits if span > 0 else None, x_spacing=spacing
    )


def _in_degrees(values: np.ndarray, names: Sequence[str], units: Sequence[str]) -> tuple[np.ndarray, list[str]]:
    turning = np.array([unit == "rad" for unit in units])
    shown = ["degrees" if unit == "rad" else unit for unit in units]
    return np.where(turning, np.degrees(values), values), [
        f"{name}, {unit}" for name, unit in zip(names, shown, strict=True)
    ]


def _finite(errors: np.ndarray) -> np.ndarray:
    """Return errors to plot: those of a diverged prediction become the largest finite error."""
    top = float(np.max(errors[np.isfinite(errors)], initial=1.0))
    return np.nan_to_num(errors, nan=top, posinf=top)


def times_valid(result: Evaluation) -> np.ndarray:
    """Return the VPT of each trajectory in frames."""
    return np.array(result.vpt["frames"])
