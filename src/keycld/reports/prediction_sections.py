"""The parts of the page on predictions: the head, movies, sheets, scores, longer horizons."""

from typing import Any

from keycld.benchmarks import MODEL_TITLES
from keycld.drawing import KEYPOINT_COLOURS, save_figure
from keycld.evaluation import PAPER_VPT, Evaluation
from keycld.reports import figures, html, movies
from keycld.reports.run import Run

VPT_SENTENCE = (
    "Valid prediction time is the share of the frames before the predicted picture is, for the first time, "
    "further from the truth than a still picture would be on average (mean squared error above ε)."
)


def head(run: Run) -> str:
    """Title, what was done in one sentence, the headline number beside its baselines, the first movie."""
    config = run.config
    system = str(config.get("system", "a system"))
    facts = [
        ("model", MODEL_TITLES.get(str(config.get("model")), config.get("model", "–"))),
        ("preset", config.get("preset", "–")),
        ("seed", config.get("seed", "–")),
    ]
    if run.metrics and "seconds" in run.metrics[-1]:
        facts.append(("training", _duration(run.metrics[-1]["seconds"])))
    line = "".join(f"<span>{html.text(name)} <b>{html.text(value)}</b></span>" for name, value in facts)
    top = f'<p class="eyebrow">KeyCLD · what one run learned</p><h1>{html.text(system.capitalize())}</h1>'
    result = run.headline
    if result is None:
        return f'<header>{top}<p class="facts">{line}</p></header>' + html.missing(
            "predictions", "Prediction", "the run has not been evaluated; run keycld eval on it"
        )
    protocol = result.scores["protocol"]
    found = " and found keypoints, their masses and an energy" if "masses" in result.scores else ""
    lede = (
        f"The model has watched recordings of the {html.text(system)}{found}. "
        f"Here it is given the first {_word(protocol['given'])} frames of {result.scores['n']} "
        f"{_split(protocol['split'])} and predicts the following {protocol['horizon'] - protocol['given']}."
    )
    return (
        f'<header>{top}<p class="lede">{lede}</p><p class="facts">{line}</p></header>'
        f'<div class="hero">{_first_movie(run, result)}{_headline(run, result)}</div>{_contents(run)}'
    )


def _contents(run: Run) -> str:
    places = {
        "movies": "movies",
        "sheets": "frames",
        "scores": "scores",
        "long": "longer horizons",
        "observation": "what it sees",
        "state": "keypoints",
        "potential": "potential energy",
        "energy": "conservation",
        "masses": "masses",
        **({"control": "control"} if run.controls else {}),
        "training": "training",
        "reproduce": "reproduce",
    }
    return "<nav>" + "".join(f'<a href="#{name}">{word}</a>' for name, word in places.items()) + "</nav>"


def _first_movie(run: Run, result: Evaluation) -> str:
    columns = ["what happened", "what the model predicted"]
    if "heat_maps" in result.arrays:
        columns.insert(1, "where it sees keypoints")
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
    vpt = scores["vpt"]["1"]
    rows = [("this model", vpt["mean"], "ours")]
    published, title = _published(scores), MODEL_TITLES.get(str(run.config.get("model")), "")
    if title in published:
        rows.append((f"the paper’s {title}", published[title], "paper"))
    told = {"constant acceleration": ", told the true states"}
    rows += [
        (name + told.get(name, ""), each["vpt"]["1"]["mean"], "trivial") for name, each in scores["baselines"].items()
    ]
    low, high = vpt["interval"]
    return (
        '<div class="headline"><div><p class="label">valid prediction time</p>'
        f'<p class="big">{vpt["mean"]:.2f}</p><p class="note">{VPT_SENTENCE}</p>'
        f'<p class="note">Median {vpt["median"]:.2f}. For other recordings of the same kind the mean would '
        "lie "
        f"between {low:.2f} and {high:.2f} (95 % bootstrap interval).</p></div>{html.bars(rows)}</div>"
    )


def trajectories(run: Run) -> str:
    """Movies of the recordings that were kept."""
    result = run.headline
    if result is None:
        return ""
    horizon = result.scores["protocol"]["horizon"]
    valid = figures.times_valid(result)
    cards = []
    for n, moving in enumerate(movies.trajectory_movies(run.folder, result)):
        state = "valid to the end" if valid[n] == horizon else f"valid for {valid[n]} of {horizon} frames"
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
    """Fig. 4 for two recordings."""
    result = run.headline
    if result is None:
        return ""
    count = min(2, len(result.arrays["truth"]))
    sheets = [movies.trajectory_sheet(run.folder, result, n) for n in range(count)]
    note = "Every sixth frame, as in Fig. 4 of the paper."
    return html.section("sheets", "Frame by frame", html.paragraph(note) + "".join(map(html.figure, sheets)))


def accuracy(run: Run) -> str:
    """Error over time, the histogram of VPT, and the scores beside the baselines'."""
    result = run.headline
    if result is None:
        return ""
    error, histogram = figures.error_figure(result), figures.vpt_figure(result)
    save_figure(run.folder / "media" / "error.png", error)
    save_figure(run.folder / "media" / "vpt.png", histogram)
    captions = (
        "Error of the predicted pictures over time: mean of all recordings, with a band from the 10th to "
        "the 90th "
        "percentile. Above the dashed ε a prediction is worth less than a still picture.",
        f"For how long each of the {result.scores['n']} recordings was predicted validly.",
    )
    charts = [
        html.figure(html.chart(error, "error"), captions[0]),
        html.figure(html.chart(histogram, "vpt"), captions[1]),
    ]
    return html.section(
        "scores",
        "How long predictions hold",
        html.grid(charts) + _score_table(result) + _definitions(result),
    )


def _score_table(result: Evaluation) -> str:
    scores = result.scores
    factors = list(scores["vpt"])
    head = ["", *(f"VPT at {_threshold(factor)}" for factor in factors), "median", "std", "squared error"]

    def row(name: str, values: dict[str, Any]) -> list[str]:
        first = values["vpt"][factors[0]]
        cells = [f"{values['vpt'][factor]['mean']:.2f}" for factor in factors]
        return [name, *cells, f"{first['median']:.2f}", f"{first['std']:.2f}", html.number(values["mse"])]

    rows = [row("<b>this model</b>", scores)]
    rows += [row(html.text(name), values) for name, values in scores["baselines"].items()]
    rows += [
        [f"paper: {html.text(name)}", f"{value:.2f}", *["–"] * (len(head) - 2)]
        for name, value in _published(scores).items()
    ]
    return html.table(head, rows, "scores")


def _published(scores: dict[str, Any]) -> dict[str, float]:
    """The paper's scores where they are about the same: 50 frames of its systems, the first two given."""
    protocol = scores["protocol"]
    same = protocol["horizon"] == 50 and protocol["given"] == 2
    return PAPER_VPT.get(scores["system"], {}) if same else {}


def _threshold(factor: str) -> str:
    return "ε" if factor == "1" else "ε/4" if factor == "0.25" else f"{factor} ε"


def _definitions(result: Evaluation) -> str:
    known = {
        "mean image": "always the mean training picture",
        "frozen frame": "the last given frame for ever",
        "constant acceleration": "continues the <em>true</em> positions of three frames on a parabola and "
        "shows the "
        "training picture nearest to it",
    }
    told = "; ".join(f"<b>{name}</b> {known[name]}" for name in result.scores["baselines"] if name in known)
    return html.paragraph(
        f"ε = {html.number(result.scores['epsilon'])}, from the validation set. "
        f"What knows nothing of motion scores too: {told}. The paper’s numbers are of 20 validation runs.",
        "note",
    )


def long_horizons(run: Run) -> str:
    """Scores, curves and movies of recordings longer than those of the headline."""
    if not run.long:
        return html.missing("long", "Longer horizons", "no evaluation on longer recordings is stored")
    rows = []
    for result in run.long:
        vpt, horizon = result.scores["vpt"]["1"], result.scores["protocol"]["horizon"]
        best = max(each["vpt"]["1"]["mean"] for each in result.scores["baselines"].values())
        name = f"{horizon} frames, {horizon * result.scores['dt']:.3g} s"
        values = [f"{vpt['mean']:.2f}", f"{vpt['median']:.2f}", f"{vpt['mean'] * horizon:.0f}", f"{best:.2f}"]
        rows.append([name, *values])
    farthest = run.long[-1]
    error = figures.error_figure(farthest)
    save_figure(run.folder / "media" / "error-long.png", error)
    names = ["horizon", "VPT", "median", "frames, mean", "best baseline"]
    cards = [
        html.figure(moving, f"<b>{n + 1}</b> · valid for {valid} of {farthest.arrays['mse'].shape[1]} frames")
        for n, (moving, valid) in enumerate(
            zip(movies.trajectory_movies(run.folder, farthest), figures.times_valid(farthest), strict=False)
        )
    ]
    horizon = farthest.scores["protocol"]["horizon"]
    driven = "" if farthest.arrays["u"].any() else " without input"
    note = (
        f"The same model on recordings of {horizon} frames{driven}, {horizon * farthest.scores['dt']:.3g} "
        "seconds. "
        f"Movies play {movies.speed(farthest)}."
    )
    chart = html.figure(html.chart(error, "error-long"), "Error over time, as above.")
    return html.section(
        "long",
        "Longer horizons",
        html.paragraph(note) + html.grid([chart, html.table(names, rows, "scores")]) + html.grid(cards, "three"),
    )


def _word(value: int) -> str:
    return {1: "one", 2: "two", 3: "three", 4: "four", 5: "five"}.get(value, str(value))


def _split(name: str) -> str:
    return {"test": "unseen recordings", "validation": "validation recordings"}.get(name, "recordings")


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"
