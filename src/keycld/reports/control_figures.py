"""A closed-loop run as a movie, as a strip of pictures (Fig. 5 of arXiv v1) and as curves."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from keycld.benchmarks import control_strip
from keycld.drawing import (
    INK,
    Curve,
    enlarge,
    overlay_keypoints,
    overlay_timeline,
    panels_figure,
    save_figure,
    save_image,
    save_movie,
    side_by_side,
)
from keycld.evaluation import Evaluation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FRAMES_PER_SECOND = 25.0


def write_control_media(folder: Path, name: str, result: Evaluation) -> tuple[Path, Path, Path]:
    """Write `media/NAME.mp4`, `media/NAME-strip.png` and `media/NAME.png` of the first trial; return their paths."""
    media = folder / "media"
    paths = (media / f"{name}.mp4", media / f"{name}-strip.png", media / f"{name}.png")
    save_movie(paths[0], trial_frames(result), _FRAMES_PER_SECOND, scale=1)
    save_image(paths[1], control_strip(result))
    save_figure(paths[2], trials_figure(result))
    return paths


def trial_frames(result: Evaluation, scale: int = 4) -> np.ndarray:
    """Return the first trial's pictures with the estimated keypoints, next to the goal, 25 a second in real time.

    The bar below is green while the goal is kept.
    """
    frames, x = result.arrays["frames"][:-1], result.arrays["x"][0]
    step = max(1, round(1 / (_FRAMES_PER_SECOND * result.scores["dt"])))
    index = np.arange(0, len(frames), step)
    keypoints = x[index].reshape(len(index), -1, 2).astype(np.float64)
    pictures = overlay_keypoints(frames[index], keypoints, scale, trail=6)
    goal = np.repeat(enlarge(result.arrays["goal_frame"][None], scale), len(index), axis=0)
    return overlay_timeline(side_by_side([pictures, goal]), result.arrays["good"][0][index], height=2 * scale)


def trials_figure(result: Evaluation) -> "Figure":
    """Plot the tilts of all trials, the inputs of the first, and its energies where the controller shapes them."""
    dt = result.scores["dt"]
    tilts, inputs = np.degrees(result.arrays["tilts"]), result.arrays["input"][0]
    time = dt * np.arange(inputs.shape[0])
    panels = []
    for k in range(tilts.shape[2]):
        low, middle, high = np.quantile(np.abs(tilts[:, :-1, k]), (0.1, 0.5, 0.9), axis=0)
        panels.append((f"|tilt| of link {k + 1}, degrees", [Curve(time, middle, "", INK.one, low=low, high=high)]))
    acting = result.scores["inputs"]
    panels += [(f"input: {name}", [Curve(time, inputs[:, k], "", INK.two)]) for k, name in enumerate(acting)]
    if "desired" in result.arrays:
        kinetic, desired = result.arrays["kinetic"][0], result.arrays["desired"][0]
        curves = [Curve(time, kinetic + desired, "", INK.one), Curve(time, desired, "", INK.four)]
        panels.append(("T + V_d, and V_d alone", curves))
    return panels_figure(panels, "seconds", columns=min(3, len(panels)), panel_size=(3.2, 2.2))
