"""Movie and figures of a clip's motion, from stored arrays."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from keycld.drawing import (
    INK,
    KEYPOINT_COLOURS,
    Curve,
    Limit,
    curves_figure,
    enlarge,
    overlay_keypoints,
    overlay_links,
    overlay_paths,
    panels_figure,
    save_movie,
)
from keycld.evaluation import Evaluation
from keycld.reports import html

_WHITE = (255, 255, 255)
_SIDE = 448
_FASTEST = 25.0


def motion_movie(folder: Path, result: Evaluation) -> str:
    """Return the movie of the test recording: observed links in white, the predicted motion in colour.

    Without links, observed keypoints are white discs, and the predicted ones lie within them while they are right.

    Writes media/motion.mp4.
    """
    arrays, scores = result.arrays, result.scores
    shown = arrays["shown_index"]
    frames = arrays["frames"]
    scale = max(1, _SIDE // frames.shape[1])
    canvas = enlarge(frames, scale)
    colours = [KEYPOINT_COLOURS[k % len(KEYPOINT_COLOURS)] for k in range(len(scores["keypoints"]))]
    predicted = arrays["predicted"][shown].astype(float)
    future = predicted.copy()
    future[shown < scores["given"]] = np.nan
    canvas = overlay_paths(canvas, future, colours, ahead=max(1, len(shown) // 8))
    observed = arrays["observed"][shown].astype(float)
    canvas = overlay_links(canvas, _ends(scores, observed), [_WHITE] * len(scores["links"]), width=0.022, opacity=0.75)
    owners = [colours[scores["keypoints"].index(link["keypoints"][-1])] for link in scores["links"]]
    canvas = overlay_links(canvas, _ends(scores, future), owners, width=0.01)
    if not scores["links"]:
        canvas = overlay_keypoints(canvas, observed, 1, radius=0.06, colours=[_WHITE])
    canvas = overlay_keypoints(canvas, np.where(np.isnan(future), observed, future), 1, radius=0.035)
    path = folder / "media" / "motion.mp4"
    step = int(shown[1] - shown[0]) if len(shown) > 1 else 1
    save_movie(path, canvas, min(_FASTEST, 1 / (scores["dt"] * step)), scale=1)
    what = "links" if scores["links"] else "keypoints"
    first = canvas[min(len(canvas) - 1, scores["given"])]
    return html.movie(path, first, None, f"Video with observed and predicted {what}")


def error_figure(result: Evaluation) -> Figure:
    """Plot the error of predicted keypoints over time next to motions without physics."""
    scores, dashed = result.scores, {"constant velocity": INK.two, "constant acceleration": INK.four}
    frames = np.arange(scores["given"], scores["frames"])

    def curve(name: str) -> np.ndarray:
        return 100 * np.clip(result.arrays[name].mean(axis=0)[scores["given"] :], 1e-4, 10.0)

    curves = [Curve(frames, curve("error"), "this model")]
    for name, colour in dashed.items():
        curves.append(Curve(frames, curve(f"error_{name.replace(' ', '_')}"), name, colour, dashed=True))
    limits = [Limit(3.0, "3 %"), Limit(10.0, "10 %")]
    return curves_figure(curves, "frame", "error, % of the size", limits=limits, logarithmic=True)


def fan_figure(result: Evaluation) -> Figure:
    """Plot how far each keypoint was observed from its prediction, within the 68 and 95 % intervals.

    What is farther than the picture is wide is cut off.
    """
    scores, arrays = result.scores, result.arrays
    rows = slice(scores["given"], None)
    time, wide = scores["dt"] * np.arange(scores["frames"])[rows], 2 / scores["pixel"]
    off, sigma = ((arrays[name] / scores["pixel"])[rows] for name in ("fan_off", "fan_sigma"))

    def interval(k: int, d: int, sigmas: float, label: str) -> Curve:
        high = np.minimum(sigmas * sigma[:, k, d], wide)
        return Curve(time, 0 * time, label, INK.one, low=-high, high=high)

    panels = []
    for k, name in enumerate(scores["keypoints"]):
        for d, axis in enumerate("xy"):
            observed = Curve(time, np.clip(off[:, k, d], -wide, wide), "observed", INK.text)
            panels.append((f"{name}, {axis}", [interval(k, d, 1.96, "predicted"), interval(k, d, 1.0, ""), observed]))
    return panels_figure(panels, "seconds", y_label="pixels", columns=2, panel_size=(4.0, 2.2))


def course_figure(result: Evaluation) -> Figure:
    """Plot each angle or place over time, observed and predicted."""
    time = result.scores["dt"] * np.arange(result.scores["frames"])
    panels = []
    for k, (title, factor) in enumerate(_coordinates(result)):
        curves = [Curve(time, factor * result.arrays["observed_course"][:, k, 0], "observed", INK.quiet)]
        if "predicted_course" in result.arrays:
            predicted = factor * result.arrays["predicted_course"][:, k, 0]
            curves.append(Curve(time, predicted, "predicted", INK.one, dashed=True))
        panels.append((title, curves))
    return panels_figure(panels, "seconds", columns=2, panel_size=(4.0, 2.4))


def phase_figure(result: Evaluation) -> Figure:
    """Plot the rate of each angle or place over itself: the phase portrait."""
    panels = []
    for k, (title, factor) in enumerate(_coordinates(result)):
        curves = []
        for name, colour in (("observed", INK.quiet), ("predicted", INK.one)):
            if f"{name}_course" in result.arrays:
                at, rate = factor * result.arrays[f"{name}_course"][:, k].T
                curves.append(Curve(at, rate, name, colour, dashed=name == "predicted"))
        panels.append((f"rate of {title.partition(',')[0]}, {title.partition(', ')[2]}/s", curves))
    return panels_figure(panels, "angle or place", columns=2, panel_size=(4.0, 3.0))


def energy_figure(result: Evaluation) -> Figure:
    """Plot kinetic, potential and total energy of the observed motion, and the total of the predicted one.

    The unit is the first total; the lowest potential energy of either motion is zero.
    """
    arrays, time = result.arrays, result.scores["dt"] * np.arange(result.scores["frames"])
    motions = [name for name in ("observed", "predicted") if f"{name}_kinetic" in arrays]
    lowest = min(float(arrays[f"{name}_potential"].min()) for name in motions)
    potential = {name: arrays[f"{name}_potential"] - lowest for name in motions}
    total = {name: arrays[f"{name}_kinetic"] + potential[name] for name in motions}
    unit = max(float(np.median(total["observed"][:10])), 1e-12)
    curves = [
        Curve(time, arrays["observed_kinetic"] / unit, "kinetic", INK.two),
        Curve(time, potential["observed"] / unit, "potential", INK.three),
        Curve(time, total["observed"] / unit, "total, observed", INK.text),
    ]
    if "predicted" in total:
        curves.append(Curve(time, total["predicted"] / unit, "total, predicted", INK.one, dashed=True))
    return curves_figure(curves, "seconds", "energy / first total", size=(7.2, 3.2))


def _coordinates(result: Evaluation) -> list[tuple[str, float]]:
    """Return title and factor of each coordinate of the course: degrees for angles, units for places."""
    angles = {link["label"] for link in result.scores["links"]}
    return [
        (f"{label}, degrees" if label in angles else f"{label}, units", np.rad2deg(1.0) if label in angles else 1.0)
        for label in result.scores["skeleton"]
    ]


def _ends(scores: dict, points: np.ndarray) -> np.ndarray:
    """Return both ends `[T, L, 2, 2]` of each link."""
    index = {name: k for k, name in enumerate(scores["keypoints"])}
    found = []
    for link in scores["links"]:
        last = points[:, index[link["keypoints"][-1]]]
        if link["point"] is None:
            first = points[:, index[link["keypoints"][0]]]
        else:
            first = np.broadcast_to(np.array(link["point"], float), last.shape)
        found.append(np.stack([first, last], axis=1))
    return np.stack(found, axis=1) if found else np.zeros((len(points), 0, 2, 2))
