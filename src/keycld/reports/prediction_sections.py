"""The sections on predictions: head of the page, movies, sheets, scores, longer horizons."""

from typing import Any

import numpy as np

from keycld.benchmarks import MODEL_TITLES
from keycld.drawing import KEYPOINT_COLOURS, save_figure
from keycld.evaluation import Evaluation, headline_vpt, published_vpt, setting_text, threshold_text
from keycld.reports import figures, html, movies
from keycld.reports.run import Run

_EXCEEDS = {
    "squared": "is further from the truth than the mean picture is on average (mean squared error above ε)",
    "normalised": "is too far from the truth (normalised error above 0.025)",
}
_ABOVE = {
    "squared": "Above the dashed ε a prediction is worse than the mean picture.",
    "normalised": "The dashed line is the threshold.",
}


def vpt_sentence(metric: str) -> str:
    """Return the definition of the valid prediction time."""
    return f"Valid prediction time is the share of the scored frames before the predicted picture {_EXCEEDS[metric]}."


def head(run: Run, sections: str) -> str:
    """Show the title, a summary in one sentence, the headline score next to its baselines, and the first movie."""
    config = run.config
    facts = [
        ("model", MODEL_TITLES.get(str(config.get("model")), config.get("model", "–"))),
        ("preset", config.get("preset", "–")),
        ("seed", config.get("seed", "–")),
    ]
    if run.metrics and "seconds" in run.metrics[-1]:
        facts.append(("training", _duration(run.metrics[-1]["seconds"])))
    line = "".join(f"<span>{html.text(name)} <b>{html.text(value)}</b></span>" for name, value in facts)
    top = f'<p class="eyebrow">KeyCLD · what one run learned</p><h1>{html.title(run.name)}</h1>'
    result = run.headline
    if run.failed:
        return f'<header>{top}<p class="facts">{line}</p></header>'
    if result is None:
        return f'<header>{top}<p class="facts">{line}</p></header>' + html.missing(
            "predictions", "Prediction", "the run has not been evaluated; run keycld eval on it"
        )
    protocol = result.scores["protocol"]
    found = " and found keypoints, their masses and an energy" if "masses" in result.scores else ""
    lede = (
        f"The model has watched recordings of the {html.text(run.name)}{found}. "
        f"Here it is given the {_end(result)} {_word(protocol['given'])} frames of {result.scores['n']} "
        f"{_split(protocol['split'])} and predicts the {protocol['horizon'] - protocol['given']} "
        f"{'before' if _end(result) == 'last' else 'after'} them."
    )
    return (
        f'<header>{top}<p class="lede">{lede}</p><p class="facts">{line}</p></header>'
        f'<div class="hero">{_first_movie(run, result)}{_headline(run, result)}</div>{html.contents(sections)}'
    )


def _first_movie(run: Run, result: Evaluation) -> str:
    columns = ["what happened", "what the model predicted"]
    if "heat_maps" in result.arrays:
        columns.insert(1, "where the model sees keypoints")
    labels = "".join(f"<span>{label}</span>" for label in columns)
    caption = (
        f"{_legend(result)} The first recording of the file, {movies.speed(result)}. "
        'The bar is <span class="good">green</span> while the prediction is valid and turns '
        '<span class="bad">red</span> when it is not.'
    )
    moving = movies.headline_movie(run.folder, result)
    above = f'<div class="labels" style="--columns:{len(columns)}">{labels}</div>'
    return html.figure(above + moving, caption)


def _legend(result: Evaluation) -> str:
    if "keypoints" not in result.arrays:
        return ""
    names = result.scores.get("keypoints") or [str(k + 1) for k in range(result.arrays["keypoints"].shape[2])]
    dots = [
        f'<span class="dot" style="background:rgb{KEYPOINT_COLOURS[k % len(KEYPOINT_COLOURS)]}"></span>'
        + html.text(name)
        for k, name in enumerate(names)
    ]
    return f"Keypoints: {', '.join(dots)}."


def _headline(run: Run, result: Evaluation) -> str:
    scores = result.scores
    vpt = result.vpt
    rows = [("this model", vpt["mean"], "ours")]
    published, title = published_vpt(scores), MODEL_TITLES.get(str(run.config.get("model")), "")
    if title in published:
        rows.append((f"the paper’s {title}", published[title], "paper"))
    for name, each in scores["baselines"].items():
        source = ", from the true states" if name == "constant acceleration" else ""
        rows.append((name + source, headline_vpt(each)["mean"], "trivial"))
    low, high = vpt["interval"]
    return (
        '<div class="headline"><div><p class="label">valid prediction time</p>'
        f'<p class="big">{vpt["mean"]:.2f}</p><p class="note">{vpt_sentence(scores["metric"])}</p>'
        f'<p class="note">Median {vpt["median"]:.2f}. For other recordings of the same kind the mean would '
        f"lie between {low:.2f} and {high:.2f} (95 % bootstrap interval).</p></div>{html.bars(rows)}</div>"
    )


def trajectories(run: Run) -> str:
    """Show movies of the stored recordings."""
    result = run.headline
    if result is None:
        return ""
    first, stop = result.scores["part"]
    valid = figures.times_valid(result)
    cards = []
    for n, moving in enumerate(movies.trajectory_movies(run.folder, result)):
        state = "valid to the end" if valid[n] == stop - first else f"valid for {valid[n]} of {stop - first} frames"
        cards.append(html.figure(moving, f"<b>{n + 1}</b> · {state}{_input(result, n)}"))
    note = (
        f"The first {len(cards)} recordings of the file, not chosen by their score. "
        "Truth on the left, prediction on the right."
    )
    return html.section("movies", "Truth and prediction", html.paragraph(note) + html.grid(cards, "three"))


def _input(result: Evaluation, n: int) -> str:
    u = result.arrays["u"]
    if u.ndim != 2:
        return ""
    values = ", ".join(f"{value:.2f}".replace("-", "−") for value in u[n])
    return f" · input {values}" if u[n].any() else " · no input"


def frame_sheets(run: Run) -> str:
    """Show two recordings frame by frame, as in Fig. 4."""
    result = run.headline
    if result is None:
        return ""
    count = min(2, len(result.arrays["truth"]))
    sheets = [movies.trajectory_sheet(run.folder, result, n) for n in range(count)]
    step = movies.sheet_step(result.arrays["shown_index"])
    note = f"One frame in {step}, as in Fig. 4 of the paper."
    return html.section("sheets", "Frame by frame", html.paragraph(note) + "".join(map(html.figure, sheets)))


def accuracy(run: Run) -> str:
    """Show the error over time, the histogram of VPT, and the scores next to those of the baselines."""
    result = run.headline
    if result is None:
        return ""
    error, histogram = figures.error_figure(result), figures.vpt_figure(result)
    save_figure(run.folder / "media" / "error.png", error)
    save_figure(run.folder / "media" / "vpt.png", histogram)
    captions = (
        "Error of the predicted pictures over time: mean of all recordings, with a band from the 10th to the 90th "
        f"percentile. {_ABOVE[result.scores['metric']]}",
        f"Valid prediction times of the {result.scores['n']} recordings.",
    )
    charts = [
        html.figure(html.chart(error, "error"), captions[0]),
        html.figure(html.chart(histogram, "vpt"), captions[1]),
    ]
    return html.section(
        "scores",
        "How long predictions are valid",
        html.grid(charts) + _score_table(result) + _definitions(result) + _other_protocols(run),
    )


def _other_protocols(run: Run) -> str:
    """Show one line for each protocol; recordings released from rest are easier than those of later motion."""
    if len(run.evaluations) < 2:
        return ""
    rows = []
    for name, result in run.evaluations.items():
        best = max(headline_vpt(each)["mean"] for each in result.scores["baselines"].values())
        cells = [f"{result.vpt['mean']:.2f}", f"{result.vpt['median']:.2f}", f"{best:.2f}"]
        rows.append([f"<b>{html.text(name)}</b> {html.text(setting_text(result.scores))}", *cells])
    return html.table(["all protocols", "VPT", "median", "best baseline"], rows, "scores")


def _score_table(result: Evaluation) -> str:
    scores = result.scores
    thresholds = list(scores["vpt"])
    named = [threshold_text(scores["metric"], threshold) for threshold in thresholds]
    head = ["", *(f"VPT at {name}" for name in named), "median", "std", "squared error"]

    def row(name: str, values: dict[str, Any]) -> list[str]:
        first = headline_vpt(values)
        cells = [f"{values['vpt'][threshold]['mean']:.2f}" for threshold in thresholds]
        return [name, *cells, f"{first['median']:.2f}", f"{first['std']:.2f}", html.number(values["mse"])]

    rows = [row("<b>this model</b>", scores)]
    rows += [row(html.text(name), values) for name, values in scores["baselines"].items()]
    rows += [
        [f"paper: {html.text(name)}", f"{value:.2f}", *["–"] * (len(head) - 2)]
        for name, value in published_vpt(scores).items()
    ]
    return html.table(head, rows, "scores")


def _definitions(result: Evaluation) -> str:
    known = {
        "mean image": "always the mean training picture",
        "frozen frame": "always the given frame nearest to the predicted ones",
        "constant acceleration": "continues the <em>true</em> positions of three frames on a parabola and shows the "
        "training picture nearest to it",
    }
    paper = " The paper’s scores are those of 20 validation recordings." if published_vpt(result.scores) else ""
    each = "; ".join(f"<b>{name}</b> {known[name]}" for name in result.scores["baselines"] if name in known)
    return html.paragraph(
        f"ε = {html.number(result.scores['epsilon'])}, from the validation set. "
        f"Baselines without a model of the motion: {each}.{paper}",
        "note",
    )


def long_horizons(run: Run) -> str:
    """Show scores, curves and movies of recordings longer than that of the headline score."""
    if not run.long:
        return html.missing("long", "Longer horizons", "no evaluation on longer recordings is stored")
    rows = []
    for named, result in run.long.items():
        vpt, horizon = result.vpt, result.scores["protocol"]["horizon"]
        best = max(headline_vpt(each)["mean"] for each in result.scores["baselines"].values())
        name = f"<b>{html.text(named)}</b> {horizon} frames, {horizon * result.scores['dt']:.3g} s"
        values = [f"{vpt['mean']:.2f}", f"{vpt['median']:.2f}", f"{np.mean(vpt['frames']):.0f}", f"{best:.2f}"]
        rows.append([name, *values])
    # Of equal ones the first: forward before backward, test before validation.
    farthest = max(run.long.values(), key=lambda each: each.scores["protocol"]["horizon"])
    first, stop = farthest.scores["part"]
    error = figures.error_figure(farthest)
    save_figure(run.folder / "media" / "error-long.png", error)
    names = ["horizon", "VPT", "median", "frames, mean", "best baseline"]
    cards = [
        html.figure(moving, f"<b>{n + 1}</b> · valid for {valid} of {stop - first} frames")
        for n, (moving, valid) in enumerate(
            zip(movies.trajectory_movies(run.folder, farthest), figures.times_valid(farthest), strict=False)
        )
    ]
    horizon = farthest.scores["protocol"]["horizon"]
    driven = "" if farthest.arrays["u"].any() else " without input"
    note = (
        f"The same model on recordings of {horizon} frames{driven}, {horizon * farthest.scores['dt']:.3g} seconds. "
        f"Movies play {movies.speed(farthest)}."
    )
    chart = html.figure(html.chart(error, "error-long"), "Error over time, as above.")
    return html.section(
        "long",
        "Longer horizons",
        html.paragraph(note) + html.grid([chart, html.table(names, rows, "scores")]) + html.grid(cards, "three"),
    )


def _end(result: Evaluation) -> str:
    return "last" if result.scores["direction"] == "backward" else "first"


def _word(value: int) -> str:
    return {1: "one", 2: "two", 3: "three", 4: "four", 5: "five"}.get(value, str(value))


def _split(name: str) -> str:
    return {"test": "unseen recordings", "validation": "validation recordings"}.get(name, "recordings")


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"
