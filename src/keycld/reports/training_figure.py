"""Training curves from metrics.jsonl."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from keycld.drawing import Curve, panels_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NOT_TERMS = {"step", "seconds", "cpu_seconds", "frames"}
# Beyond this an axis overflows; a term that broke is not plotted either.
_LARGEST = 1e30


def terms(metrics: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Return the lines with each loss term or score, by its name: the total loss first, scores last."""
    found: dict[str, list[Mapping[str, Any]]] = {}
    for line in metrics:
        for name, value in line.items():
            if name not in _NOT_TERMS and isinstance(value, int | float) and abs(value) < _LARGEST:
                found.setdefault(name, []).append(line)
    return {name: found[name] for name in sorted(found, key=lambda name: (name != "loss", "vpt" in name))}


def training_figure(metrics: Sequence[Mapping[str, Any]]) -> "Figure | None":
    """Plot each term with more than one value over minutes, with stage boundaries as hairlines; None without any."""
    series = {name: lines for name, lines in terms(metrics).items() if len(lines) > 1}
    if not series:
        return None
    panels = [(name.replace("_", " "), [_curve(lines, name)]) for name, lines in series.items()]
    figure = panels_figure(panels, "minutes", columns=3, marks=_stage_marks(metrics), panel_size=(3.7, 2.1))
    for axes, (name, curves) in zip(figure.axes, panels, strict=False):
        y = curves[0].y[np.isfinite(curves[0].y)]
        if "vpt" in name:
            axes.set_ylim(0.0, 1.05)
        elif np.all(y > 0) and y.max() > 5.0 * y.min():
            axes.set_yscale("log")
    return figure


def _minutes(line: Mapping[str, Any]) -> float:
    return float(line.get("seconds", line["step"])) / 60.0


def _curve(lines: Sequence[Mapping[str, Any]], name: str) -> Curve:
    """Return a term over minutes, with gaps between stages, unless each stage has one value."""
    minutes, values = [], []
    repeated = len(lines) > len({line.get("stage") for line in lines})
    for before, line in zip([lines[0], *lines], lines, strict=False):
        if repeated and line.get("stage") != before.get("stage"):
            minutes.append(np.nan)
            values.append(np.nan)
        minutes.append(_minutes(line))
        values.append(float(line[name]))
    return Curve(np.array(minutes), np.array(values))


def _stage_marks(metrics: Sequence[Mapping[str, Any]]) -> list[tuple[float, str]]:
    """Return the first minute of each stage, with its name if that does not overlap the one before."""
    span = max(_minutes(line) for line in metrics)
    marks, seen, free = [], None, -np.inf
    for line in metrics:
        if line.get("stage") == seen:
            continue
        seen = line.get("stage")
        x, word = _minutes(line), str(seen)
        fits = x >= free
        marks.append((x, word if fits else ""))
        if fits:
            # A letter is about a fiftieth of a panel wide.
            free = x + span * 0.02 * (len(word) + 2)
    return marks
