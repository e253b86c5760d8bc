"""The sections on a clip: the movie, the constants with their error bars, prediction, course and energy."""

from collections.abc import Mapping
from typing import Any

from keycld.drawing import save_figure
from keycld.evaluation import Constant, Physics, pieces_note, restless, value_text
from keycld.reports import clip_figures, html
from keycld.reports.run import Run


def head(run: Run) -> str:
    """Show the title, a summary, and the movie of the last third of the clip."""
    result = run.motion
    assert result is not None
    scores = result.scores
    facts = {"frames/s": f"{1 / scores['dt']:.4g}", "seed": run.config.get("seed", "–")}
    if run.physics is not None and run.physics["mechanism"]:
        facts = {"mechanism": run.physics["mechanism"], **facts}
    line = "".join(f"<span>{html.text(key)} <b>{html.text(value)}</b></span>" for key, value in facts.items())
    lede = (
        "The first part of a video taught the model how this mechanism moves. Here it is given the first "
        f"{scores['given']} frames of the last third, and predicts the other {scores['frames'] - scores['given']}."
    )
    movie = html.figure(clip_figures.motion_movie(run.folder, result), caption(scores), "clip")
    top = f'<p class="eyebrow">KeyCLD · the physics of a clip</p><h1>{html.title(run.name)}</h1>'
    return f'<header>{top}<p class="lede">{lede}</p><p class="facts">{line}</p></header>{movie}'


def caption(scores: Mapping[str, Any]) -> str:
    """Say what the movie shows: links, or keypoints alone where the mechanism has none."""
    shown = f"predicted from the first {scores['given']} frames shown, and dots where the keypoints will be next."
    if scores["links"]:
        return f"Grey-white: the links as observed in the video. In colour: the links as {shown}"
    return f"White: the keypoints as observed in the video. In colour: the keypoints as {shown}"


def acting(physics: Mapping[str, Any]) -> str:
    """Name the forces that act; next to springs a constant force may be gravity or move their rest position."""
    known = "gravity" in physics["constants"]
    constant = "gravity" if known else "a constant force (gravity, or the rest position of a spring)"
    return ", ".join([constant, *physics.get("forces", [])])


def about(physics: Physics) -> str:
    """Say what the numbers of the table are measured in, and on what."""
    said = (
        f"Times are at {physics['fps']:.4g} frames a second. “Units” are those of the image plane: 1 is half of "
        "the side of the cropped picture. ± is one standard error."
    )
    if note := pieces_note(physics):
        said += f" The constants were {note}."
    if changes := physics.get("changes"):
        said += f" In the video, {'; '.join(changes)}."
    return said


def constants(run: Run) -> str:
    """Show the physical constants with error bars, next to what the user has measured."""
    if run.physics is None:
        return "" if run.motion is None else html.missing("constants", "Constants", "they have not been measured")
    given = run.physics.get("given", {})
    rows = [_constant(name, each, given.get(name)) for name, each in run.physics["constants"].items()]
    notes = "".join(
        html.paragraph(f"<code>{html.text(name)}</code>: {html.text(each['note'])}.", "note")
        for name, each in run.physics["constants"].items()
        if "note" in each
    )
    said = restless(run.physics["prediction"].get("noise", {})), run.physics.get("note", "")
    notes = "".join(html.paragraph(f"Caution: {html.text(each)}") for each in said if each) + notes
    table = html.table(["constant", "value", "given", "unit"], rows, "scores")
    forces = html.paragraph(f"Forces that act: {html.text(acting(run.physics))}.")
    first = html.paragraph(html.text(about(run.physics)))
    return html.section("constants", "Constants", first + table + forces + notes)


def _constant(name: str, each: Constant, given: float | None) -> tuple[str, ...]:
    known = "" if given is None else f"{given:.4g}"
    return f"<code>{html.text(name)}</code>", value_text(each), known, html.text(each["unit"])


def rejected(run: Run) -> str:
    """Show which forces were tried and dropped, and on what evidence."""
    if run.physics is None or not run.physics["rejected"]:
        return ""
    rows = [
        (html.text(kind), f"{100 * each['worth']:.1f} %", f"{100 * each['needed']:.0f} %")
        for kind, each in run.physics["rejected"].items()
    ]
    note = (
        "These forces were tried and dropped: without one of them the cost of the fit rises by the share in the second "
        "column, and a force must be worth the share in the third."
    )
    table = html.table(["force", "the cost rises by", "needed"], rows, "scores")
    return html.section("rejected", "What was rejected", html.paragraph(note) + table)


def alternatives(run: Run) -> str:
    """Show the mechanisms that were compared, where none was told."""
    compared = [] if run.physics is None else run.physics.get("alternatives", [])
    if not compared:
        return ""
    rows = [
        (
            html.text(("→ " if each["chosen"] else "") + (each["mechanism"] or "without a name")),
            html.text(", ".join(each["keypoints"])),
            html.text(", ".join(f"{name} {residual:.1%}" for name, residual in each["constraints"].items()) or "none"),
            str(each["freedom"]),
            "–" if each["prediction"] is None else html.percent(each["prediction"]),
        )
        for each in compared
    ]
    note = (
        "Parts that move were told apart by their colours. Each constraint has the deviation of the track from it, as "
        "a share of the track's extent. Where all are small, the dynamics were fitted to the training part, and "
        "predicted the validation part: the last column, as a share of the extent of the motion. Of the predictions "
        "that are nearly as good as the best, the one with the fewest degrees of freedom was chosen."
    )
    table = html.table(["mechanism", "keypoints", "constraints", "freedom", "prediction off by"], rows, "scores")
    return html.section("alternatives", "Which mechanism", html.paragraph(note) + table)


def prediction(run: Run) -> str:
    """Show the error of the prediction over time next to motions without physics, and the residuals of the skeleton."""
    if run.motion is None:
        return ""
    scores = run.motion.scores
    followed = {"this model": scores, **scores["baselines"]}
    rows = [
        (html.text(name), *(html.percent(each["error"][key]) for key in ("rms", "largest", "end")), *_valid(each))
        for name, each in followed.items()
    ]
    limits = [f"frames below {float(limit):.0%}" for limit in scores["valid"]]
    table = html.table(["", "rms", "largest", "last tenth", *limits], rows, "scores")
    size, pixel = scores["size"], scores["pixel"]
    note = (
        "The error is the largest distance of a predicted keypoint from the observed one, as a share of the size of "
        f"the mechanism ({size:.3g} units, {size / pixel:.1f} pixels). The other two are polynomials through the same "
        "given frames."
    )
    chart = _chart(run, "motion-error", clip_figures.error_figure(run.motion))
    residuals = [
        (html.text(name), html.percent(each["residual"]), html.percent(each["largest"]))
        for name, each in scores["skeleton"].items()
    ]
    skeleton = html.table(["constraint", "residual, rms", "largest"], residuals, "scores")
    caption = "How far observed distances are from their mean, in all frames of the clip, as a share of the length."
    parts = html.figure(chart) + html.figure(table) + _fan(run) + html.figure(skeleton, caption)
    return html.section("prediction", "Prediction", html.paragraph(note) + parts)


def _fan(run: Run) -> str:
    """Show the prediction with error bars."""
    assert run.motion is not None
    if "within" not in run.motion.scores:
        return ""
    within = run.motion.scores["within"]
    caption = (
        "Observed minus predicted, by the measured constants and from the same frames. Shades are the 68 and 95 % "
        "intervals of an observation, with the errors of the first state, of the constants and of the keypoint itself. "
        f"They hold {within['68']:.0%} and {within['95']:.0%} of what was observed."
    )
    return html.figure(_chart(run, "fan", clip_figures.fan_figure(run.motion)), caption)


def course(run: Run) -> str:
    """Show coordinates over time, the phase portrait and the energy."""
    if run.motion is None or "observed_course" not in run.motion.arrays:
        return ""
    # Constraints of a user's own kind have no angle, nor a place along a line, to show.
    if not run.motion.arrays["observed_course"].shape[1]:
        return ""
    result = run.motion
    moved = html.figure(_chart(run, "course", clip_figures.course_figure(result)), "Angles from hanging straight down.")
    phase = html.figure(_chart(run, "phase", clip_figures.phase_figure(result)), "Phase portrait.")
    energy = html.figure(
        _chart(run, "motion-energy", clip_figures.energy_figure(result)),
        "Energy of the observed motion and of the predicted one; friction takes some. The common factor of mass and "
        "force is not known, so the unit is the first total.",
    )
    return html.section("course", "Motion and energy", html.grid([moved, phase]) + energy)


def _chart(run: Run, name: str, figure: Any) -> str:
    save_figure(run.folder / "media" / f"{name}.png", figure)
    return html.chart(figure, name)


def _valid(each: Mapping[str, Any]) -> list[str]:
    return [f"{frames:.0f}" for frames in each["valid"].values()]
