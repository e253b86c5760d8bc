"""What one trained model has learned, from its stored evaluation: the layouts of the paper's Figs. 1, 5 and 8 to 12."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Shaped, UInt8

from keycld.drawing import (
    Curve,
    enlarge,
    labelled_sheet,
    map_figure,
    overlay_heat_maps,
    overlay_keypoints,
    sheet,
    side_by_side,
    strip_figure,
)
from keycld.evaluation import Evaluation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STRIP_PICTURES = 9
_V = "V, arb. units"
_HALF_SPAN = 0.58
"""Half of the vertical axis, in units of the largest range of V: a little more than the curve needs."""


def observation_sheet(shown: Sequence[tuple[str, Evaluation, int]], scale: int = 3) -> UInt8[np.ndarray, "H W 3"]:
    """Show the way from a picture to keypoints and back (Fig. 1), one recording a row.

    The columns are a given frame, the heat maps (where the model has them), the observed keypoints, and the picture
    that the renderer makes of the state at that frame.

    Args:
        shown: label, evaluation with `observed_keypoints`, and number of the stored recording, one a row.
        scale: enlargement of the pictures.
    """
    rows = [_observation(result, n, scale) for _, result, n in shown]
    pictures = [np.stack(list(row.values())) for row in rows]
    return labelled_sheet(pictures, [label for label, _, _ in shown], list(rows[0]), scale=1)


def _observation(result: Evaluation, n: int, scale: int) -> dict[str, UInt8[np.ndarray, "H W 3"]]:
    """Return the pictures of one row by their titles."""
    arrays = result.arrays
    # The second frame: the state is inferred at it, so nothing has been predicted yet.
    frame = min(1, len(arrays["shown_index"]) - 1)
    truth = arrays["truth"][n, frame][None]
    row = {"given frame": enlarge(truth, scale)[0]}
    if "heat_maps" in arrays:
        row["heat maps"] = overlay_heat_maps(truth, arrays["heat_maps"][n, frame][None], scale)[0]
    observed = arrays["observed_keypoints"][n, frame][None].astype(np.float64)
    row["keypoints"] = overlay_keypoints(truth, observed, scale)[0]
    row["rendered"] = enlarge(arrays["prediction"][n, frame][None], scale)[0]
    return row


def control_strip(result: Evaluation, scale: int = 2) -> UInt8[np.ndarray, "H W 3"]:
    """Show the first trial of a closed-loop run until the goal is kept, then its last frame and the goal (Fig. 5)."""
    frames, dt, settled = result.arrays["frames"], result.scores["dt"], result.scores["settled_seconds"][0]
    last = len(frames) - 1
    # Most of a trial looks like its end; a trial that never settles is shown as a whole.
    stop = last if settled is None else min(max(round(settled / dt), _STRIP_PICTURES), last)
    index = [*np.round(np.linspace(0, stop, _STRIP_PICTURES - 1)).astype(int), last]
    row = enlarge(np.concatenate([frames[index], result.arrays["goal_frame"][None]]), scale)
    heads = [f"{k * dt:.2g} s" for k in index] + ["goal"]
    return side_by_side([frame[None] for frame in row], heads, gap=2)[0]


class Potential(NamedTuple):
    """A figure of the learned potential energy V.

    Attributes:
        name: of the sweep.
        vary: names of the coordinates that change, one along a path, two over a grid.
        figure: V in the model's own unit.
    """

    name: str
    vary: tuple[str, ...]
    figure: "Figure"


def potential_figures(sweeps: Mapping[str, np.ndarray]) -> list[Potential]:
    """Plot V along each path with pictures above it (Figs. 8 to 12), and over each grid of two coordinates.

    All paths share one vertical span, as Figs. 9 and 10 do, so a coordinate on which V hardly depends shows as a flat
    line.

    Args:
        sweeps: arrays of `evaluation/sweeps.npz`, as `evaluate_sweeps` describes them.
    """
    kinds = [
        (str(name), tuple(str(vary).split(",")), str(units).split(","))
        for name, vary, units in zip(sweeps["names"], sweeps["vary"], sweeps["units"], strict=True)
    ]
    paths = [name for name, vary, _ in kinds if len(vary) == 1 and name != "grid"]
    span = max((float(np.ptp(sweeps[f"{name}/potential"])) for name in paths), default=1.0)
    found = []
    for name, vary, units in kinds:
        values, labels = _in_degrees(sweeps[f"{name}/values"], vary, units)
        if len(vary) == 2:
            found.append(Potential(name, vary, _grid_figure(sweeps, name, values, labels)))
        elif name in paths:  # a grid of one coordinate is the same path again, with fewer points
            found.append(Potential(name, vary, _path_figure(sweeps, name, values[:, 0], labels[0], span)))
    return found


def grid_pictures(sweeps: Mapping[str, np.ndarray], name: str) -> UInt8[np.ndarray, "H W 3"]:
    """Return every other picture of a grid of two coordinates, laid out like the map of V: the first row is lowest."""
    rows, columns = sweeps[f"{name}/shape"]
    image = sweeps[f"{name}/image"].reshape(rows, columns, *sweeps[f"{name}/image"].shape[1:])
    return sheet(list(image[::2, ::2][::-1]), every=1)


def _path_figure(
    sweeps: Mapping[str, np.ndarray], name: str, values: Shaped[np.ndarray, "n"], label: str, span: float
) -> "Figure":
    picked = np.round(np.linspace(0, len(values) - 1, _STRIP_PICTURES)).astype(int)
    keypoints = sweeps[f"{name}/keypoints"][picked].astype(np.float64)
    pictures = overlay_keypoints(sweeps[f"{name}/image"][picked], keypoints, scale=3)
    potential = sweeps[f"{name}/potential"]
    middle = 0.5 * (potential.max() + potential.min())
    limits = (-_HALF_SPAN * span, _HALF_SPAN * span) if span > 0 else None
    spacing = 45.0 if label.endswith("degrees") else None
    curve = Curve(values, potential - middle)
    return strip_figure([curve], pictures, label, _V, y_limits=limits, x_spacing=spacing)


def _grid_figure(
    sweeps: Mapping[str, np.ndarray], name: str, values: Float[np.ndarray, "n 2"], labels: Sequence[str]
) -> "Figure":
    rows, columns = sweeps[f"{name}/shape"]
    potential = sweeps[f"{name}/potential"]
    table = (potential - potential.min()).reshape(rows, columns)
    axes = values.reshape(rows, columns, 2)
    down, right = (90.0 if label.endswith("degrees") else None for label in labels)
    return map_figure(table, axes[0, :, 1], axes[:, 0, 0], labels[1], labels[0], _V, spacings=(right, down))


def _in_degrees(
    values: Float[np.ndarray, "n d"], names: Sequence[str], units: Sequence[str]
) -> tuple[Float[np.ndarray, "n d"], list[str]]:
    """Convert angles to degrees, and label each coordinate with its unit."""
    angles = np.array([unit == "rad" for unit in units])
    shown = ["degrees" if unit == "rad" else unit for unit in units]
    labels = [f"{name}, {unit}" for name, unit in zip(names, shown, strict=True)]
    return np.where(angles, np.degrees(values), values), labels
