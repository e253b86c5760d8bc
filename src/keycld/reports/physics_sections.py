"""The sections on the learned physics: keypoints, energies, constraints, masses."""

from collections.abc import Mapping
from typing import Any

from keycld.benchmarks import grid_pictures, potential_figures
from keycld.drawing import save_figure, save_image
from keycld.evaluation import keypoint_names
from keycld.reports import figures, html, movies
from keycld.reports.run import Run
from keycld.vision import pixel_size


def observation(run: Run) -> str:
    """Show frames, their keypoints and the frames rendered from these (Fig. 1)."""
    result = run.headline
    if result is None or "observed_keypoints" not in result.arrays:
        return html.missing("observation", "What the model sees", "a model without keypoints")
    note = (
        "A given frame of the first recordings, its heat maps and keypoints, and the frame rendered from the keypoints "
        "alone. Compare Fig. 1 of the paper."
    )
    pictures = html.figure(movies.observation_sheet(run.folder, result), "One recording in each row.")
    return html.section("observation", "What the model sees", html.paragraph(note) + pictures)


def keypoints(run: Run) -> str:
    """Show how well the keypoints determine the true state."""
    result = run.headline
    if result is None or "state" not in result.scores:
        return html.missing(
            "state", "Keypoints and the true state", "the data does not tell the true positions of keypoints"
        )
    state = result.scores["state"]
    pixel = pixel_size(*result.arrays["truth"].shape[2:4])
    rows = [
        ["observed in a frame", html.number(state["residual"]), f"{state['residual'] / pixel:.2f}"],
        ["predicted, all frames", html.number(state["rollout"]), _pixels(state["rollout"], pixel)],
        ["predicted, last frame", html.number(state["rollout_last"]), _pixels(state["rollout_last"], pixel)],
    ]
    chart = figures.coordinate_figure(result)
    save_figure(run.folder / "media" / "state.png", chart)
    last = "; ".join(
        f"{html.text(each['name'])} {_with_unit(each['last_median'], each['unit'])}" for each in state["coordinates"]
    )
    note = (
        "True states are no part of the training. The error of an affine map from the keypoints to the true positions "
        f"of {html.text(' and '.join(state['landmarks']))}, fitted on validation frames, measures how well the "
        f"keypoints determine them. Median error of the true coordinates at the last frame: {last}."
    )
    return html.section(
        "state",
        "Keypoints and the true state",
        html.paragraph(note)
        + html.grid(
            [
                html.figure(
                    html.chart(chart, "state"),
                    "Error of the true coordinates along the predictions: median and 10th to 90th percentile.",
                ),
                html.table(["root mean square distance", "image units", "pixels"], rows, "scores"),
                *_law(state),
            ]
        ),
    )


def _law(state: Mapping[str, Any]) -> list[str]:
    """Return a table of what is known of the learned law, if anything."""
    rows, rates = [], state.get("friction")
    if state.get("acceleration") is not None:
        rows.append(["error of the acceleration, rms", html.percent(state["acceleration"]), ""])
    if rates:
        shown = [html.number(rates[which]) for which in ("found", "true")]
        rows.append(["rate at which friction takes energy, 1/s", *shown])
    return [html.table(["along true motions", "learned law", "truth"], rows, "scores")] if rows else []


def _with_unit(value: float | None, unit: str) -> str:
    return f"{html.number(value)}°" if unit == "deg" else f"{html.number(value)} {html.text(unit)}"


def _pixels(distance: float | None, pixel: float) -> str:
    return "–" if distance is None else f"{distance / pixel:.2f}"


def potential(run: Run) -> str:
    """Show the learned potential energy over the configuration (Figs. 8 to 12)."""
    if run.sweeps is None:
        return html.missing("potential", "Learned potential energy", "no sweeps are stored, or the model has no energy")
    charts, wide = [], []
    for name, vary, figure in potential_figures(run.sweeps):
        save_figure(run.folder / "media" / f"potential-{name}.png", figure)
        varied = " and ".join(map(html.text, vary))
        shown = html.chart(figure, f"potential-{name}")
        if len(vary) == 2:
            grid = grid_pictures(run.sweeps, name)
            save_image(run.folder / "media" / f"potential-{name}-pictures.png", grid)
            pictures = html.image(grid, f"Pictures of the grid of {varied}")
            wide.append(html.figure(shown, f"V over every combination of {varied}."))
            wide.append(html.figure(pictures, "The frames of this grid, every other row and column."))
        else:
            charts.append(html.figure(shown, f"V as {varied} changes, all else at rest."))
    note = (
        "The model learned the potential energy from the motion alone. V is evaluated at the keypoints that the model "
        "observes in each frame. Only its shape has a meaning: V is known up to a constant and, together with masses "
        "and inputs, up to one factor. All curves have the same scale, so a flat line means that gravity does not act "
        "along that coordinate. Compare Figs. 8 to 12 of the paper."
    )
    return html.section(
        "potential", "Learned potential energy", html.paragraph(note) + "".join(charts) + html.grid(wide)
    )


def conservation(run: Run) -> str:
    """Show energies along roll-outs without input, and the deviation from the constraints."""
    # Results of backward predictions hold no roll-out without input.
    found = [result for result in (run.headline, *run.long.values()) if result and "free_kinetic" in result.arrays]
    if not found:
        return html.missing("energy", "Energy along a roll-out", "the model has no energies")
    result = found[-1]
    energies = figures.energy_figure(result)
    save_figure(run.folder / "media" / "energy.png", energies)
    drift = result.scores["drift"]
    horizon = result.scores["protocol"]["horizon"]
    note = (
        "Without input only friction should change the sum of kinetic and potential energy. Over "
        f"{horizon} frames the total changes by {html.percent(drift['energy']['mean'])} of the largest kinetic "
        f"energy (worst {html.percent(drift['energy']['worst'])})."
    )
    parts = [
        html.figure(
            html.chart(energies, "energy"),
            "Energies of the predicted motion, in the model’s own unit; the lowest V is 0.",
        )
    ]
    if "constraint" in drift:
        worst = drift["constraint"]["worst"]
        kept = worst is not None and worst < 1e-6
        note += f" The constraints, such as the length of a rod, hold within {html.number(worst)}"
        note += ", the rounding error of single precision." if kept else "."
    if "deviation" in result.arrays and not kept:
        deviation = figures.deviation_figure(result)
        save_figure(run.folder / "media" / "constraint.png", deviation)
        caption = "Deviation of the predicted motion from the constraints."
        parts.append(html.figure(html.chart(deviation, "constraint"), caption))
    return html.section("energy", "Energy along a roll-out", html.paragraph(note) + "".join(parts))


def masses(run: Run) -> str:
    """Show the learned masses as ratios."""
    if run.headline is None or not run.headline.scores.get("masses"):
        return html.missing("masses", "Learned masses", "the model has none")
    scores = run.headline.scores
    values = scores["masses"]
    names = keypoint_names(scores.get("keypoints", ()), len(values))
    total = sum(values)
    rows = [
        (html.text(name), f"{value / values[0]:.3f}", f"{100 * value / total:.1f} %")
        for name, value in zip(names, values, strict=True)
    ]
    note = (
        "All masses, the potential energy and the input forces can be multiplied by one number without a change of the "
        "motion, so a video determines only their ratios. A point mass also replaces a whole rigid part, so its share "
        "need not be that of the material."
    )
    if len(values) == 1:
        note += " With a single keypoint there is no ratio; its mass only sets the unit."
        return html.section("masses", "Learned masses", html.paragraph(note))
    head = ["keypoint", f"mass relative to {html.text(names[0])}", "share"]
    return html.section("masses", "Learned masses", html.paragraph(note) + html.table(head, rows, "scores"))
