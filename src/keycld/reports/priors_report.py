"""The page of the suite `priors`: heat maps of sets and models, tables, roll-outs, cost against score."""

from collections.abc import Sequence
from pathlib import Path

from keycld.benchmarks import (
    Board,
    Experiment,
    Place,
    boards,
    cost_figure,
    done_results,
    model_title,
    shown_protocols,
    tables,
)
from keycld.benchmarks.pictures import gallery, sheet_of
from keycld.reports import html
from keycld.reports.page import write_page
from keycld.reports.suite_report import experiments_section, suite_head, table_figure

_NOTE = (
    "Valid prediction time is the share of the frames after the 64th before the predicted picture’s normalised error "
    "first exceeds 0.025; backward it is counted from the given end. Five frames are given unless a cell says "
    "otherwise. The last column is a constant picture, the mean of the training frames: on sets whose colours vary it "
    "passes now and then. The paper shows the best of 4 to 16 variants of a model, chosen by their score; ours is one."
)


def write_priors_report(experiments: Sequence[Experiment], place: Place, folder: str | Path) -> Path:
    """Write `report.html` into a folder; return its path.

    Heat maps, tables and cost need the recorded results alone; roll-outs those run folders that are there.

    Args:
        experiments: of the suite.
        place: where their results and run folders are.
        folder: of the page.
    """
    found, results = boards(experiments, place), done_results(experiments, place)
    models = list(dict.fromkeys(experiment.model for experiment in experiments))
    labels = list(dict.fromkeys(experiment.data.label for experiment in experiments))
    sections = (
        html.section("tables", "Tables 1, 5 and 6", "".join(map(table_figure, tables(experiments, place))))
        + _rollouts(experiments, place, labels)
        + _cost(experiments, place, models)
        + experiments_section(experiments, place)
    )
    maps = "".join(heat_map(board, labels, models) for board in found)
    first = maps + html.paragraph(_NOTE, "note")
    body = suite_head(experiments, [result for _, result in results], first, sections) + sections
    footer = f"Written by <b>keycld bench report {html.text(experiments[0].suite)}</b> from recorded results."
    return write_page(Path(folder) / "report.html", f"{experiments[0].suite} · benchmark", body, footer)


def heat_map(board: Board, labels: Sequence[str], models: Sequence[str]) -> str:
    """Return a table of sets and models, darker where a score is better; an empty cell says why it is empty.

    Errors are shaded by their share of the constant picture's error.
    """
    digits, rows = board.measure.digits, []
    for label in labels:
        cells = [html.text(label)]
        for model in models:
            cell, note = board.cells.get((label, model)), html.text(board.notes.get((label, model), "–"))
            if cell is None:
                cells.append(f"<small>{note}</small>")
                continue
            still = board.trivial.get(label) or cell.mean
            share = cell.mean if board.measure.part is None else 1.0 - cell.mean / max(still, 1e-12)
            shade = f"rgb(42 120 142 / {0.75 * min(max(share, 0.0), 1.0):.2f})"
            cells.append(f'<span style="background:{shade};padding:.1em .5em">{cell.mean:.{digits}f}</span>')
        still = board.trivial.get(label)
        rows.append([*cells, "–" if still is None else f"{still:.{digits}f}"])
    head = ["", *(html.text(model_title(model)) for model in models), "mean image"]
    return html.figure(html.table(head, rows, "scores"), html.text(board.measure.title) + ".")


def _rollouts(experiments: Sequence[Experiment], place: Place, labels: Sequence[str]) -> str:
    pictures = []
    for protocol in shown_protocols(experiments):
        for label in labels:
            shown = gallery(experiments, place, label, protocol)
            if shown is None:
                continue
            description = f"Frames of {label}: truth and models"
            picture = html.image(sheet_of(shown, every=max(1, len(shown.truth) // 16)), description)
            direction = "backward, from the last frames" if protocol.backward else "forward"
            pictures.append(html.figure(picture, f"<b>{html.text(label)}</b> · {direction}, first trajectory."))
    if not pictures:
        return html.missing("rollouts", "Roll-outs", "none of the run folders is there")
    return html.section("rollouts", "Roll-outs", "".join(pictures))


def _cost(experiments: Sequence[Experiment], place: Place, models: Sequence[str]) -> str:
    rows, headline = [], experiments[0].protocols[0].name
    for model in models:
        mine = [result for each, result in done_results(experiments, place) if each.model == model]
        if not mine:
            rows.append([html.text(model_title(model)), "0", "–", "–"])
            continue
        minutes = sum(result["training"]["seconds"] for result in mine) / 60.0 / len(mine)
        scores = [next(iter(result["scores"][headline]["vpt"].values()))["mean"] for result in mine]
        score = f"{sum(scores) / len(scores):.3f}"
        rows.append([html.text(model_title(model)), str(len(mine)), f"{minutes:.1f}", score])
    head = ["model", "trainings", "minutes of one, mean", "VPT forward, mean"]
    figure = cost_figure(experiments, place)
    plot = "" if figure is None else html.figure(html.chart(figure, "cost"), "A point for each set and seed.")
    return html.section("cost", "Cost and score", html.table(head, rows) + plot)
