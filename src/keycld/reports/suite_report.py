"""The page of a suite of experiments: tables, errors over time, sheets and movies of all models."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from keycld.benchmarks import (
    Experiment,
    Illustration,
    Illustrations,
    Place,
    Table,
    done_results,
    error_figure,
    illustrate,
    model_title,
    movie_of,
    status_of,
    suite_named,
    tables,
)
from keycld.reports import html
from keycld.reports.page import write_page

_HORIZON_NOTE = (
    "Valid prediction time is the share of the frames before the predicted picture is, for the first time, further "
    "from the truth than the mean picture is on average. ± gives the standard deviation over training seeds, with "
    "their number in brackets. Scores without brackets do not depend on a seed. The paper’s scores are those of 20 "
    "validation recordings."
)


def write_suite_report(experiments: Sequence[Experiment], place: Place, folder: str | Path) -> Path:
    """Write `report.html` into a folder, and figures, sheets and movies into its `media/`; return the page's path.

    Tables and errors over time need the recorded results alone; all else is of the run folders that are there.

    Args:
        experiments: of one suite.
        place: where their results and run folders are.
        folder: of the page.

    Raises:
        KeycldError: none of the experiments is done, or the folder cannot be written.
    """
    folder = Path(folder)
    made = illustrate(experiments, place, folder / "media")
    found = tables(experiments, place)
    results = done_results(experiments, place)
    sections = (
        _errors(experiments, place)
        + _sheets(made)
        + _movies(made)
        + _learned(made)
        + _scores(found[1:])
        + experiments_section(experiments, place)
    )
    first = table_figure(found[0]) + html.paragraph(_HORIZON_NOTE, "note")
    body = suite_head(experiments, [result for _, result in results], first, sections) + sections
    footer = f"Written by <b>keycld bench report {html.text(experiments[0].suite)}</b> from recorded results."
    return write_page(folder / "report.html", f"{experiments[0].suite} · benchmark", body, footer)


def suite_head(experiments: Sequence[Experiment], results: Sequence[dict[str, Any]], first: str, sections: str) -> str:
    """Return the head of the page: what was run, its first table, links to the sections."""
    suite = suite_named(experiments[0].suite)
    machines = dict.fromkeys(f"{r['machine']['processor']}, {r['machine']['cores']} cores" for r in results)
    hours = sum(result["training"]["seconds"] for result in results) / 3600.0
    facts = [
        ("preset", experiments[0].preset),
        ("experiments", f"{len(results)} of {len(experiments)} done"),
        ("training", f"{hours:.1f} hours"),
        ("on", "; ".join(machines)),
    ]
    line = "".join(f"<span>{html.text(name)} <b>{html.text(value)}</b></span>" for name, value in facts)
    return (
        f'<header><p class="eyebrow">benchmark</p><h1>{html.text(suite.name)}</h1>'
        f'<p class="lede">{html.text(suite.title)}.</p><p class="facts">{line}</p></header>'
        f"{first}{html.contents(sections)}"
    )


def table_figure(table: Table) -> str:
    """Return a table of scores with its title below."""
    rows, noted = [], any(row.note for row in table.rows)
    for row in table.rows:
        name = f"<b>{html.text(row.name)}</b>" if row.kind == "ours" else html.text(row.name)
        rows.append([name, *table.texts(row), *([html.text(row.note)] if noted else [])])
    head = ["", *map(html.text, table.columns), *([""] if noted else [])]
    return html.figure(html.table(head, rows, "scores"), html.text(table.title) + ".")


def _errors(experiments: Sequence[Experiment], place: Place) -> str:
    charts = []
    for protocol in experiments[0].protocols:
        figure = error_figure(experiments, place, protocol)
        if figure is not None:
            caption = f"{protocol.split}.h5, {protocol.horizon} frames, {protocol.given} given."
            charts.append(html.figure(html.chart(figure, f"error-{protocol.name}"), caption))
    note = (
        "Mean squared error of the predicted pictures, mean over recordings and seeds, with a band from the 10th to "
        "the 90th percentile of the recordings. Above the dashed ε a prediction is worse than the mean picture. "
        "Compare Fig. 3 of the paper."
    )
    return html.section("errors", "Error over time", html.paragraph(note) + "".join(charts))


def _sheets(made: Illustrations) -> str:
    if not made.pictures:
        return html.missing("sheets", "Frame by frame", "none of the run folders is there")
    pictures = []
    for each in made.pictures:
        description = f"Frames of {html.text(each.gallery.label)}: truth and models"
        pictures.append(html.figure(f'<img src="{html.data_uri(each.sheet)}" alt="{description}">', _caption(each)))
    note = "Ground truth above, every model below, as in Figs. 13 to 15 of the paper. The first recording of the file."
    return html.section("sheets", "Frame by frame", html.paragraph(note) + "".join(pictures))


def _movies(made: Illustrations) -> str:
    if not made.pictures:
        return html.missing("movies", "Side by side", "none of the run folders is there")
    moving = []
    for k, each in enumerate(made.pictures):
        # A GIF is large, so only the first movie has one, for browsers that cannot play H.264.
        fallback = each.movie.with_suffix(".gif") if k == 0 else None
        label = f"Truth and all models on {each.gallery.label}, moving"
        moving.append(html.figure(html.movie(each.movie, movie_of(each.gallery)[-1], fallback, label), _caption(each)))
    note = "A bar turns red when the prediction above it stops being valid."
    return html.section("movies", "Side by side", html.paragraph(note) + "".join(moving))


def _learned(made: Illustrations) -> str:
    note = (
        "Learned keypoints and energies of KeyCLD, one trained model for each data set. V is known up to a constant "
        "and a factor. Compare Figs. 1, 5 and 8 to 12 of the paper."
    )
    pictures = []
    for each in made.paper.made:
        title = html.text(each.title)
        pictures.append(html.figure(f'<img src="{html.data_uri(each.path)}" alt="{title}">', f"{title}."))
    left_out = [html.paragraph(html.text(sentence), "note") for sentence in made.paper.left_out]
    return html.section("learned", "What KeyCLD learned", "".join([html.paragraph(note), *pictures, *left_out]))


def _caption(made: Illustration) -> str:
    protocol, seeds = made.protocol, made.gallery.seeds
    same = len(set(seeds.values())) == 1
    each = ", ".join(f"{html.text(title)} with seed {seed}" for title, seed in seeds.items())
    shown = f"seed {next(iter(seeds.values()))}" if same else each
    name = html.text(made.gallery.label)
    return f"<b>{name}</b> · {protocol.split}.h5, {protocol.given} frames given of {protocol.horizon} · {shown}."


def _scores(found: Sequence[Table]) -> str:
    return html.section("scores", "All scores", "".join(map(table_figure, found)))


def experiments_section(experiments: Sequence[Experiment], place: Place) -> str:
    """Return the state of every experiment, and the commands of those that are done."""
    rows, commands = [], []
    for experiment in experiments:
        status = status_of(experiment, place)
        cells = [html.text(status.word), html.text(model_title(experiment.model)), "–", "–", html.text(status.detail)]
        if status.word == "done" and status.result is not None:
            cells[2] = f"{status.result['training']['seconds'] / 60.0:.1f}"
            cells[3] = html.text(str(status.result["commit"])[:10])
            commands.append(status.result["command"])
        rows.append([html.text(experiment.name), *cells])
    head = ["experiment", "state", "model", "minutes", "commit", ""]
    done = "\n".join(html.text(each) for each in commands)
    details = f"<details><summary>Commands</summary><pre><code>{done}</code></pre></details>"
    return html.section("experiments", "Experiments", html.table(head, rows) + details)
