"""The recorded result of an experiment: small, and complete without its run folder."""

import json
import re
import time
from pathlib import Path
from typing import Annotated, Any, NotRequired, TypedDict

import numpy as np

from keycld import _records
from keycld._errors import KeycldError
from keycld._files import write_text
from keycld._records import NumberText, Unexpected, read_lines
from keycld.benchmarks.experiment import Experiment, Place, digest
from keycld.data import read_statistics
from keycld.evaluation import Evaluation, load_evaluation
from keycld.training import environment

_CURVE_POINTS = 50


class Failure(TypedDict):
    """What `record_failure` writes."""

    config_hash: str
    during: str
    kind: str
    sentence: str


class _Vpt(TypedDict):
    mean: float


class _Friction(TypedDict):
    found: float | None
    true: float | None


class _State(TypedDict):
    acceleration: NotRequired[float | None]
    friction: NotRequired[_Friction | None]


class _Scores(TypedDict):
    vpt: dict[NumberText, _Vpt]
    epsilon: float
    state: NotRequired[_State]
    table_units: NotRequired[dict[str, float | None]]
    baselines: dict[str, dict[str, float | dict[str, float | None]]]


def _comparable(scores: dict[str, Any], where: str) -> dict[str, Any]:
    """Return the scores under a protocol, if trivial predictors are scored at each of its thresholds."""
    thresholds = scores["vpt"].keys()
    for name, baseline in scores["baselines"].items():
        if missing := thresholds - baseline.keys():
            raise Unexpected(f"'{where}.baselines.{name}.{min(missing)}' is missing")
    return scores


class _Curve(TypedDict):
    frame: list[int]
    mean: list[float]
    low: list[float]
    high: list[float]


def _even(curve: dict[str, Any], where: str) -> dict[str, Any]:
    """Return a curve, if its lists have the same length."""
    if len({len(curve[name]) for name in _Curve.__required_keys__}) > 1 or not curve["frame"]:
        raise Unexpected(f"the lists of '{where}' do not have the same length")
    return curve


class _Cost(TypedDict):
    seconds: float
    cpu_seconds: float
    frames: int


class _Config(TypedDict):
    settings: dict[str, Any]
    minutes: NotRequired[float | None]
    share: NotRequired[float]
    together: NotRequired[int]


class _Machine(TypedDict):
    processor: str
    cores: int | None


class _Environment(_Machine):
    commit: str | None
    devices: list[str]
    packages: dict[str, Any]
    python: str


class Result(TypedDict):
    """What `condense` returns: the fields that tables and figures read."""

    config_hash: str
    command: str
    commit: str | None
    commit_scored: str | None
    machine: _Machine
    training: _Cost
    seconds: dict[str, float]
    scores: dict[str, Annotated[_Scores, _comparable]]
    curves: dict[str, Annotated[_Curve, _even]]


def condense(experiment: Experiment, place: Place, seconds: dict[str, float]) -> dict[str, Any]:
    """Return the result of a run that is trained and evaluated, as JSON values.

    Args:
        experiment: the experiment.
        place: where its run folder and data are.
        seconds: time of each part of the work, of the processes that were not killed; `training.seconds` counts all.

    Returns:
        command, seed, commit and machine; hashes of configuration and data; cost; the scores under each protocol and
        the error over time.
    """
    run, data = place.run(experiment), place.data(experiment)
    config = read_json(run / "config.json", _Config)
    trained_in = read_json(run / "environment.json", _Environment)
    statistics, lines = read_statistics(data), read_lines(run / "metrics.jsonl", _Cost)
    if config is None or trained_in is None or statistics is None or not lines:
        raise KeycldError(f"{run} or {data} lacks results of the training: train again.")
    last = lines[-1]
    stored = {protocol.name: load_evaluation(run, protocol.name) for protocol in experiment.protocols}
    return {
        "experiment": experiment.name,
        "suite": experiment.suite,
        "command": command(experiment),
        "system": experiment.data.system,
        "data": experiment.data.label,
        "model": experiment.model,
        "preset": experiment.preset,
        "seed": experiment.seed,
        "settings": config["settings"],
        "minutes": config.get("minutes"),
        "share": config.get("share", 1.0),
        "together": config.get("together", 1),
        # Of the first process of the training, and of the process that evaluated.
        "commit": trained_in["commit"],
        "commit_scored": environment()["commit"],
        "machine": {name: trained_in[name] for name in ("processor", "cores", "devices", "packages", "python")},
        "config_hash": experiment.hash(),
        "data_hash": digest({name: split["sha256"] for name, split in statistics["splits"].items()}),
        "data_recipe_hash": digest(statistics["recipe"]),
        "training": {name: last[name] for name in ("seconds", "cpu_seconds", "frames", "step")},
        "seconds": {name: round(value, 1) for name, value in seconds.items()},
        "scores": {name: _scores(each.scores) for name, each in stored.items()},
        "curves": {name: _curve(each) for name, each in stored.items()},
    }


def command(experiment: Experiment) -> str:
    """Return the command that does only this experiment, with its data and scores."""
    words = ["keycld bench run", experiment.suite, "--only", experiment.name, "--seeds", str(experiment.seed)]
    words += ["--models", experiment.model, "--preset", experiment.preset]
    if experiment.minutes is not None:
        words += ["--minutes", f"{experiment.minutes:g}"]
    if experiment.settings:
        words += ["--set", *(f"{name}={_value(value)}" for name, value in experiment.settings.items())]
    return " ".join(words)


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ",".join(map(_value, value)) + ("," if len(value) == 1 else "")
    return str(value).lower() if isinstance(value, bool) else str(value)


def _scores(scores: dict[str, Any]) -> dict[str, Any]:
    """Return the scores under one protocol without those of single trajectories."""
    known = ("normalised_error", "table_units", "state", "drift", "masses", "frames_passed")
    return {
        "given": scores["protocol"]["given"],
        "horizon": scores["protocol"]["horizon"],
        **{name: scores[name] for name in ("metric", "direction", "part", "threshold")},
        "vpt": {
            factor: {name: value for name, value in vpt.items() if name != "frames"}
            for factor, vpt in scores["vpt"].items()
        },
        "mse": scores["mse"],
        "epsilon": scores["epsilon"],
        "baselines": {
            name: {factor: vpt["mean"] for factor, vpt in each["vpt"].items()}
            | ({"table_units": each["table_units"]} if "table_units" in each else {})
            for name, each in scores["baselines"].items()
        },
        **{name: scores[name] for name in known if name in scores},
    }


def _curve(result: Evaluation) -> dict[str, Any]:
    """Return the error over time: mean over trajectories, 10th and 90th percentile, at 50 frames.

    An error that is not finite counts as the largest finite one; `not_finite` is the share of such frames.
    """
    errors = result.errors
    finite = np.isfinite(errors)
    top = float(np.max(errors[finite], initial=0.0))
    errors = np.where(finite, errors, top)
    index = np.unique(np.round(np.linspace(0, errors.shape[1] - 1, _CURVE_POINTS)).astype(int))
    picked = errors[:, index]
    low, high = np.quantile(picked, (0.1, 0.9), axis=0)
    return {
        "frame": index.tolist(),
        "mean": _rounded(picked.mean(axis=0)),
        "low": _rounded(low),
        "high": _rounded(high),
        "not_finite": float(np.mean(~finite)),
    }


def _rounded(values: np.ndarray) -> list[float]:
    """Return values with four digits, enough for a figure."""
    return [float(f"{value:.4g}") for value in values]


def write_json(path: Path, value: Any) -> None:
    """Write a JSON value as readable text, with each list of numbers on one line; completely or not at all."""
    text = json.dumps(value, indent=1, allow_nan=False)
    text = re.sub(r"\[\s+([^\[\]{}]*?)\s+\]", lambda found: "[" + re.sub(r"\s+", " ", found[1]) + "]", text)
    write_text(path, text + "\n")


def read_json(path: Path, kind: Any) -> dict[str, Any] | None:
    """Return the value that `write_json` wrote, of a type as `_records.checked` takes, or None without such a file.

    Raises:
        KeycldError: the file is damaged.
    """
    try:
        return _records.read_json(path, kind, "delete it and repeat the command that made it")
    except FileNotFoundError:
        return None


def record_failure(experiment: Experiment, place: Place, during: str, kind: str, sentence: str) -> None:
    """Record a failure for `bench status`; the next `bench run` repeats the experiment.

    Args:
        experiment: what failed.
        place: where its record goes.
        during: part of the work.
        kind: name of the error or signal.
        sentence: message of the error.
    """
    failure = {
        "experiment": experiment.name,
        "command": command(experiment),
        "config_hash": experiment.hash(),
        "during": during,
        "kind": kind,
        "sentence": sentence,
        "time": time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime()),
    }
    write_json(place.failure(experiment), failure)
