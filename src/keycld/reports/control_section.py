"""The section on control: successes, inputs, timing, and pictures of the first trial."""

from typing import Any

from keycld.benchmarks import control_strip
from keycld.evaluation import Evaluation
from keycld.reports import control_figures, html
from keycld.reports.run import Run

_TITLES = {
    "shaping": "energy shaping",
    "paper": "energy shaping, eq. (15) as printed",
    "mpc": "planned motions, tracked",
    "zero": "no input",
    "random": "random input",
}


def control(run: Run) -> str:
    """Return movie, strip and curves of each closed-loop run; an empty text without any."""
    if not run.controls:
        return ""
    note = (
        "Each camera picture gives keypoints, the learned dynamics turn them into positions and velocities, and the "
        "control law moves the simulated system to the pose of one goal picture. It never receives a true state. A "
        "trial is a success if the goal is kept during the whole last second."
    )
    rows = [_row(result.scores) for result in run.controls.values()]
    head = ["control", "acting", "limit of u", "successes", "largest u", "step, median", "99th percentile", "misses"]
    parts = [html.paragraph(note), html.table(head, rows, "scores")]
    for name, result in run.controls.items():
        if result.scores["law"] not in ("zero", "random"):
            parts.append(_trial(run, name, result))
    return html.section("control", "Control from pixels", "".join(parts))


def _row(scores: dict[str, Any]) -> list[str]:
    step = scores["step"]
    limit = scores["limit"]
    return [
        html.text(_title(scores)),
        html.text(", ".join(scores["acting"])),
        "none" if limit is None else html.number(limit),
        f"{scores['successes']} of {scores['n']}",
        html.text(", ".join(f"{value:.3g}" for value in scores["largest_input"])),
        f"{step['median_ms']:.1f} ms",
        f"{step['p99_ms']:.1f} of {step['period_ms']:.0f} ms",
        f"{step['missed']} of {step['frames']}",
    ]


def _title(scores: dict[str, Any]) -> str:
    words = [str(_TITLES.get(scores["law"], scores["law"]))]
    disturbance = scores["disturbance"]
    if disturbance["noise"]:
        words.append(f"{100 * disturbance['noise']:.0f} % noise")
    if disturbance["dropped"]:
        words.append(f"{100 * disturbance['dropped']:.0f} % of frames dropped")
    if scores["estimator"] != "predict-correct":
        words.append("velocity by differences")
    if scores["goal"] != "upright":
        words.append("goal from a picture")
    return ", ".join(words)


def _trial(run: Run, name: str, result: Evaluation) -> str:
    scores = result.scores
    movie, _, _ = control_figures.write_control_media(run.folder, name, result)
    frames = control_figures.trial_frames(result)
    strip = control_strip(result)
    settled = scores["settled_seconds"][0]
    caption = f"{html.text(_title(scores))}: the first trial, next to the goal. The bar is green while the goal is kept"
    caption += "." if settled is None else f", from {settled:.1f} s to the end."
    parts = [
        html.figure(html.movie(movie, frames[-1], None, "Camera picture with keypoints, and the goal"), caption),
        html.figure(html.image(strip, "Pictures until the goal is kept, and the goal"), "Compare Fig. 5."),
        html.figure(html.chart(control_figures.trials_figure(result), name), _curves_caption(scores)),
    ]
    return "".join(parts)


def _curves_caption(scores: dict[str, Any]) -> str:
    words = f"Tilts: median and 10th to 90th percentile of {scores['n']} trials. Inputs: the first trial."
    if "passivity" in scores:
        rise = 100 * scores["passivity"]["largest_rise_median"]
        words += (
            f" In a passive closed loop T + V<sub>d</sub> never rises; here its largest rise is {html.number(rise)} % "
            "of its largest value (median of trials). Mean learned mass: "
            f"{html.number(scores['mean_mass'])}; this scale is arbitrary, and only the law of the paper depends on it."
        )
    return words
