"""The states of experiments."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

from keycld._errors import KeycldError
from keycld._files import read_text, remove_orphans
from keycld._lock import holder
from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.results import Failure, Result, read_json
from keycld.evaluation import headline_vpt

# Files of a run folder that are the bench's own.
LOCK, LOG = "bench.lock", "bench.log"
_SILENT_SECONDS = 120.0

Word = Literal["done", "running", "failed", "stale", "missing"]


class Status(NamedTuple):
    """The state of an experiment, a remark on it, and its recorded result, if there is one."""

    word: Word
    detail: str
    result: dict[str, Any] | None


def status_of(experiment: Experiment, place: Place) -> Status:
    """Return whether an experiment is done, running, failed, stale or missing.

    - done: there is a result with the current hash of the experiment and all its protocols. The run folder is not
      needed.
    - running: a process holds the lock in the run folder.
    - failed: the last attempt with the current hash failed.
    - stale: there is a result, but of other settings, data, constraints or protocols.
    - missing: none of these; an interrupted run will be resumed.
    """
    path = place.result(experiment)
    try:
        result, damage = read_json(path, Result), ""
    except KeycldError as error:
        result, damage = None, str(error)
    now = experiment.hash()
    if result is not None and result.get("config_hash") == now and _complete(result, experiment):
        return Status("done", "", result)
    lock = holder(place.run(experiment) / LOCK)
    if lock is not None:
        detail = f"process {lock.pid} on {lock.host}, for {_minutes(lock.age)}"
        if lock.silent > _SILENT_SECONDS:
            detail += f", without a sign of life for {_minutes(lock.silent)}"
        return Status("running", detail, result)
    try:
        failure = read_json(place.failure(experiment), Failure)
    except KeycldError as error:
        failure, damage = None, damage or str(error)
    if failure is not None and failure["config_hash"] == now:
        return Status("failed", f"{failure['kind']} during {failure['during']}: {failure['sentence']}", result)
    if result is not None:
        changed = "other protocols" if result.get("config_hash") == now else "another configuration"
        return Status("stale", f"recorded for {changed}", result)
    pointer = place.run(experiment) / "checkpoints" / "latest"
    if pointer.exists():
        return Status("missing", f"interrupted after {read_text(pointer).strip()}", None)
    return Status("missing", damage, None)


def remove_leftovers(experiment: Experiment, place: Place) -> None:
    """Remove the hidden folders of killed processes, also where everything that they wrote is complete."""
    run = place.run(experiment)
    for folder in (run, run / "evaluation", place.result(experiment).parent):
        if folder.is_dir():
            remove_orphans(folder)


def status_table(experiments: Sequence[Experiment], place: Place) -> str:
    """Return a table with one line for each experiment."""
    width = max(len(experiment.name) for experiment in experiments)
    headline = experiments[0].protocols[0].name
    lines = [f"{'experiment':{width}}  {'state':8}{'VPT':>6}{'minutes':>9}  (VPT: {headline}; minutes of training)"]
    for experiment in experiments:
        status = status_of(experiment, place)
        shown = ""
        if status.word == "done" and status.result is not None:
            vpt = headline_vpt(status.result["scores"][experiment.protocols[0].name])["mean"]
            shown = f"{vpt:6.3f}{status.result['training']['seconds'] / 60.0:9.1f}"
        lines.append(f"{experiment.name:{width}}  {status.word:8}{shown:15}  {status.detail}".rstrip())
    return "\n".join(lines)


def count_states(experiments: Sequence[Experiment], place: Place) -> dict[str, int]:
    """Return the number of experiments in each state."""
    words = [status_of(experiment, place).word for experiment in experiments]
    return {word: words.count(word) for word in dict.fromkeys(words)}


def _complete(result: dict[str, Any], experiment: Experiment) -> bool:
    return all(
        set(map("{:g}".format, protocol.thresholds)) <= result["scores"].get(protocol.name, {"vpt": {}})["vpt"].keys()
        and protocol.name in result["curves"]
        for protocol in experiment.protocols
    )


def _minutes(seconds: float) -> str:
    return f"{seconds / 60.0:.0f} min" if seconds >= 60.0 else f"{seconds:.0f} s"
