"""Matplotlib figures without a window or global state: curves, histograms, maps, strips of pictures."""

import contextlib
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Shaped, UInt8

from keycld.drawing.frames import sheet
from keycld.drawing.palette import INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.titleweight": "normal",
    "axes.titlelocation": "left",
    "axes.titlecolor": INK.quiet,
    "axes.labelsize": 9.0,
    "axes.labelcolor": INK.quiet,
    "axes.edgecolor": INK.line,
    "axes.facecolor": "none",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.unicode_minus": True,
    "figure.facecolor": INK.paper,
    "text.color": INK.text,
    "xtick.color": INK.line,
    "ytick.color": INK.line,
    "xtick.labelcolor": INK.quiet,
    "ytick.labelcolor": INK.quiet,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.handlelength": 1.4,
    "lines.linewidth": 1.6,
    "lines.solid_capstyle": "round",
}


@dataclass(frozen=True)
class Curve:
    """One curve y(x), with an optional band between `low` and `high`.

    Attributes:
        x: `[n]`.
        y: `[n]`; NaN leaves a gap.
        label: in the legend; empty for none.
        colour: hexadecimal; by default the next of the palette.
        dashed: for what is not a result (baselines, references).
        low: lower edge of the band `[n]`.
        high: upper edge of the band `[n]`.
        points: plot points without a line between them.
    """

    x: Shaped[np.ndarray, "n"]
    y: Shaped[np.ndarray, "n"]
    label: str = ""
    colour: str | None = None
    dashed: bool = False
    low: Shaped[np.ndarray, "n"] | None = None
    high: Shaped[np.ndarray, "n"] | None = None
    points: bool = False


@dataclass(frozen=True)
class Limit:
    """A dashed line with a name: horizontal, or vertical in a histogram.

    Attributes:
        value: where it crosses its axis.
        label: its name.
        colour: hexadecimal.
    """

    value: float
    label: str
    colour: str = INK.limit


@contextlib.contextmanager
def _new_figure(width: float, height: float) -> Iterator["Figure"]:
    """Yield an empty figure, inches, in our style while it is filled."""
    # Here, as everywhere, Matplotlib is imported when something is drawn: it takes most of a second.
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        yield Figure(figsize=(width, height), layout="constrained")


def curves_figure(
    curves: Sequence[Curve],
    x_label: str,
    y_label: str,
    *,
    limits: Sequence[Limit] = (),
    logarithmic: bool = False,
    size: tuple[float, float] = (5.4, 3.2),
) -> "Figure":
    """Plot curves with bands over one axis, with dashed limits (the layout of the KeyCLD paper's Fig. 3)."""
    with _new_figure(*size) as figure:
        axes = figure.add_subplot()
        _plot(axes, curves, logarithmic)
        if any(curve.label for curve in curves):
            figure.legend(loc="outside upper left", ncols=2)  # outside: the curves cross all of the axes
        for limit in limits:
            _plot_limit(axes, limit)
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        return figure


def panels_figure(
    panels: Sequence[tuple[str, Sequence[Curve]]],
    x_label: str,
    *,
    y_label: str = "",
    columns: int = 3,
    logarithmic: bool = False,
    marks: Sequence[tuple[float, str]] = (),
    limits: Sequence[Limit] = (),
    panel_size: tuple[float, float] = (2.9, 1.9),
) -> "Figure":
    """Plot small multiples: one titled panel for each entry, on one horizontal axis.

    Args:
        panels: pairs of a title and the curves under it; the first panel's labels are the legend of all.
        x_label: below the lowest row.
        y_label: left of the first column.
        columns: panels in a row.
        logarithmic: whether the vertical axes are.
        marks: vertical hairlines (x, text) in every panel; the texts are above the first row.
        limits: horizontal dashed lines, one for each panel, or none.
        panel_size: width and height, inches.
    """
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    with _new_figure(columns * panel_size[0], rows * panel_size[1] + 0.25) as figure:
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True)
        for k, axes in enumerate(grid.flat):
            if k >= len(panels):
                axes.set_axis_off()
                continue
            title, curves = panels[k]
            _plot(axes, curves, logarithmic)
            axes.set_title(title, color=INK.text, pad=14.0 if marks and k < columns else 6.0)
            for x, word in marks:
                axes.axvline(x, color=INK.line, linewidth=0.8, zorder=0)
                if k < columns and word:
                    axes.annotate(
                        word, (x, 1.0), (2, 2), xycoords=("data", "axes fraction"),
                        textcoords="offset points", fontsize=6.5, color=INK.quiet, annotation_clip=False,
                    )  # fmt: skip
            if limits:
                _plot_limit(axes, limits[k])
            if k % columns == 0:
                axes.set_ylabel(y_label)
            if k + columns >= len(panels):
                axes.set_xlabel(x_label)
                axes.tick_params(labelbottom=True)
        handles, words = grid.flat[0].get_legend_handles_labels()
        if handles:
            figure.legend(handles, words, loc="outside upper left", ncols=min(len(words), 2 * columns))
        return figure


def histogram_figure(
    values: Float[np.ndarray, "n"],
    x_label: str,
    y_label: str,
    *,
    span: tuple[float, float] = (0.0, 1.0),
    bins: int = 20,
    limits: Sequence[Limit] = (),
    size: tuple[float, float] = (5.4, 3.2),
) -> "Figure":
    """Plot how many of `values` fall in each of `bins` equal bins of `span`, with dashed vertical limits."""
    from matplotlib.ticker import MaxNLocator

    with _new_figure(*size) as figure:
        axes = figure.add_subplot()
        _, edges, _ = axes.hist(values, bins=bins, range=span, color=INK.one, rwidth=0.88)
        for limit in limits:
            axes.axvline(limit.value, color=limit.colour, linewidth=1.2, linestyle=(0, (4, 3)), label=limit.label)
        if limits:
            figure.legend(loc="outside upper left", ncols=len(limits))
        width = edges[1] - edges[0]
        axes.set_xlim(span[0] - 0.3 * width, span[1] + 0.3 * width)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        return figure


def map_figure(
    values: Float[np.ndarray, "rows columns"],
    x: Float[np.ndarray, "columns"],
    y: Float[np.ndarray, "rows"],
    x_label: str,
    y_label: str,
    value_label: str,
    *,
    spacings: tuple[float | None, float | None] = (None, None),
    size: tuple[float, float] = (5.4, 4.5),
) -> "Figure":
    """Plot a function of two variables as colours with contour lines; `values[i, j]` is at (`x[j]`, `y[i]`)."""
    from matplotlib.ticker import MultipleLocator

    with _new_figure(*size) as figure:
        axes = figure.add_subplot()
        mesh = axes.pcolormesh(x, y, values, cmap="viridis", shading="nearest", rasterized=True)
        if np.ptp(values) > 0.0:
            axes.contour(x, y, values, levels=8, colors="white", linewidths=0.6, alpha=0.6)
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        for axis, spacing in zip((axes.xaxis, axes.yaxis), spacings, strict=True):
            if spacing is not None:
                axis.set_major_locator(MultipleLocator(spacing))
        bar = figure.colorbar(mesh, ax=axes, label=value_label, shrink=0.9)
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
        return figure


def strip_figure(
    curves: Sequence[Curve],
    thumbnails: UInt8[np.ndarray, "n H W 3"],
    x_label: str,
    y_label: str,
    *,
    y_limits: tuple[float, float] | None = None,
    x_spacing: float | None = None,
    width: float = 11.0,
    curve_height: float = 1.8,
) -> "Figure":
    """Plot curves below a strip of pictures (the layout of the KeyCLD paper's Figs. 8 to 12).

    The pictures, two or more, are evenly spaced: the first above the lowest x, the last above the highest.
    """
    from matplotlib.ticker import MultipleLocator

    number = len(thumbnails)
    low, high = (float(edge(curves[0].x)) for edge in (np.min, np.max))
    margin = (high - low) / (number - 1) / 2.0
    strip_height = width / number * thumbnails.shape[1] / thumbnails.shape[2]
    with _new_figure(width, curve_height + strip_height + 0.4) as figure:
        above, below = figure.subplots(2, 1, height_ratios=(1.05 * strip_height, curve_height))
        above.imshow(sheet([thumbnails], every=1, gap=2), interpolation="nearest", aspect="equal")
        above.set_anchor("S")
        above.set_axis_off()
        _plot(below, curves, logarithmic=False)
        below.set_xlim(low - margin, high + margin)
        if y_limits is not None:
            below.set_ylim(*y_limits)
        if x_spacing is not None:
            below.xaxis.set_major_locator(MultipleLocator(x_spacing))
        below.set_xlabel(x_label)
        below.set_ylabel(y_label)
        return figure


def figure_svg(figure: "Figure", name: str) -> str:
    """Convert a figure to an `<svg>` element for a page, with its words as text.

    `name` keeps the identifiers of several figures in one page apart.
    """
    import matplotlib

    settings: Any = {"svg.fonttype": "none", "svg.hashsalt": name, "figure.facecolor": "none"}
    with matplotlib.rc_context(settings), io.StringIO() as buffer:
        figure.savefig(buffer, format="svg", facecolor="none", metadata={"Date": None})
        text = buffer.getvalue()
    return text[text.index("<svg") :]


def _plot_limit(axes: "Axes", limit: Limit) -> None:
    axes.axhline(limit.value, color=limit.colour, linewidth=1.0, linestyle=(0, (4, 3)))
    axes.annotate(
        limit.label, (1.0, limit.value), (3, 0), xycoords=("axes fraction", "data"),
        textcoords="offset points", ha="left", va="center", color=limit.colour, fontsize=8.5,
    )  # fmt: skip


def _plot(axes: "Axes", curves: Sequence[Curve], logarithmic: bool) -> None:
    for k, curve in enumerate(curves):
        colour = curve.colour or INK.cycle[k % len(INK.cycle)]
        if curve.low is not None and curve.high is not None:
            axes.fill_between(curve.x, curve.low, curve.high, color=colour, alpha=0.16, linewidth=0.0)
        style = (0, (4, 2)) if curve.dashed else "-"
        weight = 1.2 if curve.dashed else 1.6
        # Few points get markers: a single one has no line.
        marker = "o" if curve.points or np.count_nonzero(np.isfinite(curve.y)) <= 8 else ""
        axes.plot(
            curve.x,
            curve.y,
            color=colour,
            linestyle="none" if curve.points else style,
            linewidth=weight,
            marker=marker,
            markersize=4.0,
            label=curve.label,
        )
    if logarithmic:
        axes.set_yscale("log")
    else:
        # Whole numbers: a power of ten above the axis would lie on the texts of marks.
        axes.yaxis.set_major_formatter("{x:g}")
    axes.grid(axis="y", color=INK.line, linewidth=0.6, alpha=0.6)
    axes.set_axisbelow(True)
    axes.margins(x=0.01)
