"""Tables 1, 5 and 6 of "Which priors matter?": published scores, ours, the winner of each, average ranks."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.published_priors import PUBLISHED
from keycld.benchmarks.status import status_of
from keycld.benchmarks.suites import model_title
from keycld.benchmarks.table import Cell, Row, Table, over_seeds
from keycld.evaluation import Protocol

Scores = Mapping[str, Mapping[str, float]]
"""A number by set and model."""


class Measure(NamedTuple):
    """What a table of the scoreboard shows.

    Attributes:
        name: a key of `PUBLISHED`.
        title: of the table.
        horizon: frames of the protocol's window.
        backward: direction of the protocol.
        part: of the errors in table units; None: the valid prediction time.
        digits: digits after the decimal point.
    """

    name: str
    title: str
    horizon: int
    backward: bool
    part: str | None
    digits: int

    def value(self, result: Mapping[str, Any]) -> float | None:
        """Return the score of a recorded result, or of a trivial predictor there; None where it has none."""
        if self.part is None:
            vpt = result.get("vpt", result)
            first = next(iter(vpt.values()))
            return first["mean"] if isinstance(first, Mapping) else first
        return result.get("table_units", {}).get(self.part)


MEASURES = (
    Measure("forward", "Table 1, VPT forward", 256, False, None, 2),
    Measure("backward", "Table 1, VPT backward", 256, True, None, 2),
    Measure("reconstruction", "Table 5, error up to the training length, 10⁷/3072", 124, False, "train", 2),
    Measure("extrapolation", "Table 6, error of the 60 frames after it, 10⁷/3072", 124, False, "extrapolation", 2),
)


class Board(NamedTuple):
    """What there is for one table.

    Attributes:
        measure: what it shows.
        ours: mean over seeds, by set and model.
        cells: the same with the spread.
        trivial: the constant mean image, by set.
        notes: why a score is missing or not comparable, such as a shortened training, by set and model.
        unfinished: sets of which an experiment has not ended; they have no ranks yet.
    """

    measure: Measure
    ours: dict[str, dict[str, float]]
    cells: dict[tuple[str, str], Cell]
    trivial: dict[str, float]
    notes: dict[tuple[str, str], str]
    unfinished: frozenset[str]


def boards(experiments: Sequence[Experiment], place: Place) -> tuple[Board, ...]:
    """Return what is recorded of some experiments, for each table that one of their protocols serves.

    Nothing is dropped: an experiment without a score has a note with its state, a failure with its kind. Data that a
    model cannot learn have the reason.
    """
    states = [(experiment, status_of(experiment, place)) for experiment in experiments]
    lacking = _lacking(experiments)
    unfinished = frozenset(each.data.label for each, status in states if status.word not in ("done", "failed"))
    found = []
    for measure in MEASURES:
        values: dict[tuple[str, str], list[float]] = {}
        trivial: dict[str, float] = {}
        remarks: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
        served = False
        for experiment, status in states:
            key = experiment.data.label, experiment.model
            protocol = next((each for each in experiment.protocols if _serves(each, measure)), None)
            if protocol is None:
                continue
            served = True
            if status.word != "done" or status.result is None:
                kind = status.detail.partition(" ")[0] if status.word == "failed" else ""
                remarks[key].append(f"{status.word} {kind}".strip())
                continue
            scores = status.result["scores"][protocol.name]
            value = measure.value(scores)
            if value is None:
                remarks[key].append("not finite")
                continue
            values.setdefault(key, []).append(value)
            if protocol.given > 5:
                remarks[key].append(f"{protocol.given} frames given")
            if status.result.get("share", 1.0) < 1.0:
                remarks[key].append(f"{status.result['share']:.0%} of the steps")
            still = measure.value(scores["baselines"]["mean image"])
            if still is not None:
                trivial[key[0]] = still
        if not served:
            continue
        # What several seeds have in common is said once.
        notes = {key: ", ".join(dict.fromkeys(each)) for key, each in remarks.items()} | lacking
        cells = {key: over_seeds(each) for key, each in values.items()}
        ours: dict[str, dict[str, float]] = {}
        for (label, model), cell in cells.items():
            ours.setdefault(label, {})[model] = cell.mean
        found.append(Board(measure, ours, cells, trivial, notes, unfinished))
    return tuple(found)


def _lacking(experiments: Sequence[Experiment]) -> dict[tuple[str, str], str]:
    """Return by set and model what the data of some experiments lack for the models of others."""
    found = {}
    for data in dict.fromkeys(each.data for each in experiments):
        for each in {each.model: each for each in experiments}.values():
            reason = replace(each, data=data).refusal
            if reason is not None:
                found[data.label, each.model] = reason
    return found


def _serves(protocol: Protocol, measure: Measure) -> bool:
    """Return whether a protocol gives the score of a table: its window and direction, 20 trajectories."""
    same = (protocol.split, protocol.horizon, protocol.backward) == ("test", measure.horizon, measure.backward)
    return same and protocol.metric == "normalised" and (protocol.trajectories or 0) <= 20


def average_ranks(scores: Scores, models: Sequence[str], *, larger: bool) -> dict[str, float]:
    """Return the mean rank of each model over the sets; 1 is best.

    Equal scores share the mean of their ranks, and a missing score is the worst. The paper's ranks are of scores with
    more digits than it prints, so its last lines differ from this by up to 0.25. In Tables 5 and 6 it counts N/A as
    rank 1, which favours RGN by 1.06 and ODE[TR] by 0.35.

    Args:
        scores: by set and model.
        models: which models.
        larger: whether a larger score is better.
    """
    worst, ranks = float("inf"), {model: [] for model in models}
    for each in scores.values():
        values = {model: (-each[model] if larger else each[model]) if model in each else worst for model in models}
        for model in models:
            less = sum(value < values[model] for value in values.values())
            equal = sum(value == values[model] for value in values.values())
            ranks[model].append(less + (equal + 1) / 2)
    return {model: sum(each) / len(each) for model, each in ranks.items() if each}


def winners(scores: Mapping[str, float], *, larger: bool) -> tuple[str, ...]:
    """Return the models with the best score of one set; several where it is the same."""
    if not scores:
        return ()
    best = max(scores.values()) if larger else min(scores.values())
    return tuple(model for model, value in scores.items() if value == best)


def priors_tables(experiments: Sequence[Experiment], place: Place) -> tuple[Table, ...]:
    """Return Tables 1, 5 and 6: for each set our scores and the published ones, with the winners; then the ranks.

    Ours are ranks over the sets of which all experiments have ended: one that has not run is not a bad score.
    """
    models = list(dict.fromkeys(experiment.model for experiment in experiments))
    labels = list(dict.fromkeys(experiment.data.label for experiment in experiments))
    found = []
    for board in boards(experiments, place):
        measure, published = board.measure, PUBLISHED[board.measure.name]
        rows = []
        for label in labels:
            cells = tuple(board.cells.get((label, model)) for model in models)
            still = board.trivial.get(label)
            trivial = None if still is None else Cell(still, None, 0)
            best = winners(board.ours.get(label, {}), larger=published.larger)
            rows.append(Row(label, "ours", (*cells, trivial), _note(best, board, label, models)))
            theirs = {model: value for model, value in published.scores.get(label, {}).items() if model in models}
            known = tuple(Cell(theirs[model], None, 0) if model in theirs else None for model in models)
            best = winners(theirs, larger=published.larger)
            rows.append(Row("  paper", "paper", (*known, None), _best(best)))
        ended = {label: scores for label, scores in board.ours.items() if label not in board.unfinished}
        ranks = average_ranks(ended, models, larger=published.larger)
        note = f"over {len(ended)} of {len(labels)} sets, the others are unfinished" if board.unfinished else ""
        rows.append(Row("average rank", "ours", (*(_rank(ranks.get(model)) for model in models), None), note))
        printed = tuple(_rank(published.ranks.get(model)) for model in models)
        rows.append(Row("  paper", "paper", (*printed, None)))
        better = "larger" if published.larger else "smaller"
        title = (
            f"{measure.title}; 5 frames given of {measure.horizon}, scored from the 65th on"
            if measure.part is None
            else f"{measure.title}; 5 frames given of {measure.horizon}"
        )
        if experiments[0].minutes is not None:
            title += f", trainings shortened to {experiments[0].minutes:g} minutes of steps"
        title += f", mean over 20 trajectories, {better} is better; ± standard deviation over seeds (number of seeds)"
        columns = (*map(model_title, models), "mean image")
        found.append(Table(measure.name, title, columns, tuple(rows), digits=measure.digits))
    return tuple(found)


def _rank(value: float | None) -> Cell | None:
    return None if value is None else Cell(value, None, 0)


def _best(models: Sequence[str]) -> str:
    return "best " + ", ".join(map(model_title, models)) if models else ""


def _note(best: Sequence[str], board: Board, label: str, models: Sequence[str]) -> str:
    """Return the winners, and why scores are missing."""
    reasons: dict[str, list[str]] = {}
    for model in models:
        if (label, model) in board.notes:
            reasons.setdefault(board.notes[label, model], []).append(model_title(model))
    parts = [f"{reason}: {', '.join(names)}" for reason, names in reasons.items()]
    return "; ".join(filter(None, [_best(best), *parts]))
