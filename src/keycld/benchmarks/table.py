"""Table 1 of arXiv v1 from recorded results: our scores (mean and spread over seeds), trivial and published ones."""

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.status import Status, status_of
from keycld.benchmarks.suites import MODEL_TITLES, model_title
from keycld.evaluation import PAPER_VPT, Protocol, protocol_named, threshold_text


class Cell(NamedTuple):
    """A mean, the spread of several values (None for one), and the number of values."""

    mean: float
    spread: float | None
    n: int

    def text(self, digits: int) -> str:
        """Return text such as `0.97 ± 0.01 (3)`, with the number of seeds if it is not 0."""
        spread = "" if self.spread is None else f" ± {self.spread:.{digits}f}"
        return f"{self.mean:.{digits}f}{spread}" + (f" ({self.n})" if self.n else "")


class Row(NamedTuple):
    """A row of a table; `kind` is `ours`, `trivial`, `paper` or `true`; `note` stands after the last cell."""

    name: str
    kind: str
    cells: tuple[Cell | None, ...]
    note: str = ""


@dataclass(frozen=True)
class Table:
    """Scores under one protocol and threshold: one column for each data set, one row for each model.

    Attributes:
        name: for files: `test@50`, `test@50 ε/4`, `acceleration`, `friction`, `minutes`.
        title: what the numbers are.
        columns: the data sets.
        rows: our models, trivial predictors, published scores.
        digits: digits after the decimal point.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]
    digits: int = 3

    def texts(self, row: Row) -> list[str]:
        """Return the cells of a row as text: a dash for a missing score, two digits for published ones."""
        digits = 2 if row.kind == "paper" else self.digits
        return ["–" if cell is None else cell.text(digits) for cell in row.cells]


def over_seeds(values: Sequence[float]) -> Cell:
    """Return mean and sample standard deviation (n − 1) of a score over seeds; no spread for a single seed."""
    n = len(values)
    mean = sum(values) / n
    spread = math.sqrt(sum((value - mean) ** 2 for value in values) / (n - 1)) if n > 1 else None
    return Cell(mean, spread, n)


def seed_tables(experiments: Sequence[Experiment], place: Place) -> tuple[Table, ...]:
    """Return one table for each protocol and threshold, those of the learned laws, and one of the training times.

    Stale results are left out (`status_of`).
    """
    results = done_results(experiments, place)
    found = []
    for protocol in experiments[0].protocols:
        for threshold in protocol.thresholds:
            found.append(_scores(experiments, results, protocol, f"{threshold:g}"))
    minutes = _ours(experiments, results, lambda result: result["training"]["seconds"] / 60.0)
    columns = data_labels(experiments)
    title = "minutes of training, wall-clock; mean ± standard deviation over seeds (number of seeds)"
    return (*found, *_laws(experiments, results), Table("minutes", title, columns, minutes, digits=1))


def done_results(experiments: Sequence[Experiment], place: Place) -> list[tuple[Experiment, dict[str, Any]]]:
    """Return the experiments that are done, with their results."""
    found: list[tuple[Experiment, Status]] = [(each, status_of(each, place)) for each in experiments]
    return [(each, status.result) for each, status in found if status.word == "done" and status.result is not None]


def provenance(experiments: Sequence[Experiment], place: Place) -> str:
    """Return a line that names the commits that scored the results of each model; it is empty without results.

    Results of several commits need not have the same recipe.
    """
    found: dict[str, dict[str, int]] = {}
    for experiment, result in done_results(experiments, place):
        commits = found.setdefault(model_title(experiment.model), {})
        commit = str(result["commit_scored"])[:7]
        commits[commit] = commits.get(commit, 0) + 1
    each = [f"{model} " + ", ".join(f"{commit} ({n})" for commit, n in of.items()) for model, of in found.items()]
    return "commits that scored (number of results): " + "; ".join(each) if each else ""


def data_labels(experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """Return the data sets, each once, in the experiments' order."""
    return tuple(dict.fromkeys(experiment.data.label for experiment in experiments))


def _scores(
    experiments: Sequence[Experiment],
    results: Sequence[tuple[Experiment, dict[str, Any]]],
    protocol: Protocol,
    threshold: str,
) -> Table:
    columns = data_labels(experiments)
    rows = _ours(experiments, results, lambda result: result["scores"][protocol.name]["vpt"][threshold]["mean"])
    first = {each.data.label: result["scores"][protocol.name]["baselines"] for each, result in reversed(results)}
    names = dict.fromkeys(name for baselines in first.values() for name in baselines)
    for name in names:
        scores = [first.get(column, {}).get(name) for column in columns]
        rows += (Row(name, "trivial", tuple(None if s is None else Cell(s[threshold], None, 0) for s in scores)),)
    if _published(experiments[0], protocol) and threshold == "1":
        for title in MODEL_TITLES.values():
            values = [PAPER_VPT[column][title] for column in columns]
            rows += (Row(f"paper: {title}", "paper", tuple(Cell(value, None, 0) for value in values)),)
    first_frame, stop = protocol.part
    word, end = threshold_text(protocol.metric, threshold), "last " if protocol.backward else ""
    title = (
        f"VPT as a part of {stop - first_frame} frames, {protocol.split}.h5, threshold {word}, {end}{protocol.given} "
        "frames given; mean ± standard deviation over seeds (number of seeds)"
    )
    headline = threshold == f"{protocol.thresholds[0]:g}"
    return Table(protocol.name + ("" if headline else f" {word}"), title, columns, rows)


def _laws(experiments: Sequence[Experiment], results: Sequence[tuple[Experiment, dict[str, Any]]]) -> list[Table]:
    """Return how exact the learned accelerations and friction are, as far as the first protocol measured them."""
    name, columns, found = experiments[0].protocols[0].name, data_labels(experiments), []
    states = [(each, result["scores"][name].get("state", {})) for each, result in results]
    moving = [(each, state["acceleration"]) for each, state in states if state.get("acceleration") is not None]
    if moving:
        title = "error of the learned acceleration along true motions, as a share of the true one, root mean squares"
        found.append(Table("acceleration", title, columns, _ours(experiments, moving, lambda error: error)))
    slowing = [(each, state["friction"]) for each, state in states if state.get("friction")]
    slowing = [(each, rates) for each, rates in slowing if None not in rates.values()]
    if slowing:
        true = {each.data.label: Cell(rates["true"], None, 0) for each, rates in slowing}
        rows = _ours(experiments, slowing, lambda rates: rates["found"])
        rows += (Row("true", "true", tuple(map(true.get, columns))),)
        found.append(Table("friction", "rate at which friction takes energy, 1/s", columns, rows))
    return found


def _published(experiment: Experiment, protocol: Protocol) -> bool:
    """Return whether Table 1 of arXiv v1 has scores for this: the same data, two of 50 frames given."""
    same = protocol_named(f"{protocol.split}@50")
    return experiment.data.protocol == "keycld-2022" and replace(protocol, shown=same.shown) == same


def _ours(
    experiments: Sequence[Experiment],
    results: Sequence[tuple[Experiment, Any]],
    value: Callable[[Any], float],
) -> tuple[Row, ...]:
    values: dict[tuple[str, str], list[float]] = {}
    for experiment, result in results:
        values.setdefault((experiment.model, experiment.data.label), []).append(value(result))
    rows = []
    for model in dict.fromkeys(experiment.model for experiment in experiments):
        found = [values.get((model, column)) for column in data_labels(experiments)]
        rows.append(
            Row(model_title(model), "ours", tuple(None if each is None else over_seeds(each) for each in found))
        )
    return tuple(rows)


def as_text(table: Table) -> str:
    """Return a table for a terminal."""
    cells = [table.texts(row) for row in table.rows]
    first = max(len(row.name) for row in table.rows)
    widths = [max(len(text) for text in column) for column in zip(table.columns, *cells, strict=True)]
    lines = [table.title, " " * first + "".join(f"   {c:>{w}}" for c, w in zip(table.columns, widths, strict=True))]
    for row, texts in zip(table.rows, cells, strict=True):
        shown = "".join(f"   {c:>{w}}" for c, w in zip(texts, widths, strict=True))
        lines.append(f"{row.name:{first}}{shown}   {row.note}".rstrip())
    return "\n".join(lines)


def as_markdown(table: Table) -> str:
    """Return a table for a page."""
    noted = any(row.note for row in table.rows)
    columns = (*table.columns, *([""] if noted else []))
    lines = [f"**{table.name}**: {table.title}.", "", f"| | {' | '.join(columns)} |", "|---" * (1 + len(columns)) + "|"]
    for row in table.rows:
        lines.append(f"| {row.name} | {' | '.join([*table.texts(row), *([row.note] if noted else [])])} |")
    return "\n".join(lines) + "\n"


def as_csv(found: Sequence[Table]) -> str:
    """Return all tables as one, a line for each cell: table, row, kind, column, mean, spread, n (0 without seeds)."""
    with io.StringIO(newline="") as buffer:
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(["table", "row", "kind", "column", "mean", "spread", "n"])
        for table in found:
            for row in table.rows:
                for column, cell in zip(table.columns, row.cells, strict=True):
                    if cell is not None:
                        spread = "" if cell.spread is None else repr(cell.spread)
                        writer.writerow([table.name, row.name, row.kind, column, repr(cell.mean), spread, cell.n])
        return buffer.getvalue()
