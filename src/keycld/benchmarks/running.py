"""Running of experiments that are missing, stale or failed, each in its own process."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import IO, Any

from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.results import record_failure
from keycld.benchmarks.status import LOG, Status, count_states, status_of
from keycld.evaluation import headline_vpt

# Exit codes of the process of an experiment.
DONE, FAILED, TAKEN, INTERRUPTED = 0, 3, 75, 130

_CHILD = (sys.executable, "-m", "keycld.benchmarks.child")


def run_experiments(
    experiments: Sequence[Experiment],
    place: Place,
    *,
    child: Sequence[str] = _CHILD,
    say: Callable[[str], None] = print,
) -> dict[str, int]:
    """Do all experiments that are not done; a failure is recorded, and the next experiment follows.

    It can be killed at any moment and called again: finished work (data, training steps up to the last checkpoint,
    scored protocols, results) is not repeated. Two calls at the same time share the work: each experiment is done by
    one of them.

    Args:
        experiments: what to do, in this order.
        place: where data, runs and results are.
        child: the command of one experiment; its arguments are the id of this process, the experiment, and the two
            folders of `place`.
        say: is called with a line about each experiment.

    Returns:
        number of experiments in each state at the end (`status_of`).
    """
    before = [status_of(experiment, place) for experiment in experiments]
    costs: dict[str, list[float]] = {}
    for experiment, status in zip(experiments, before, strict=True):
        _note(costs, experiment, status)
    left = [experiment for experiment, status in zip(experiments, before, strict=True) if status.word != "done"]
    say(f"{len(experiments)} experiments, {len(experiments) - len(left)} done, {len(left)} to do{_left(costs, left)}")
    width = max(len(experiment.name) for experiment in experiments)
    for number, experiment in enumerate(left, start=1):
        since = time.monotonic()
        status = status_of(experiment, place)
        if status.word not in ("done", "running"):
            code = _do(experiment, place, child)
            if code not in (DONE, FAILED, TAKEN):
                _record_crash(experiment, place, code)
            status = status_of(experiment, place)
        _note(costs, experiment, status)
        line = f"[{number}/{len(left)}] {experiment.name:{width}}  {_outcome(experiment, status)}"
        say(f"{line}  {_clock(time.monotonic() - since)}{_left(costs, left[number:])}")
    return count_states(experiments, place)


def _do(experiment: Experiment, place: Place, child: Sequence[str]) -> int:
    arguments = [str(os.getpid()), experiment.to_json(), str(place.root), str(place.results)]
    with _output(place.run(experiment)) as out:
        process = subprocess.Popen([*child, *arguments], stdin=subprocess.DEVNULL, stdout=out, stderr=out)
        try:
            code = process.wait()
        except BaseException:
            process.terminate()
            process.wait()
            raise
    if code == INTERRUPTED:
        raise KeyboardInterrupt
    return code


@contextlib.contextmanager
def _output(run: Path) -> Iterator[IO[Any]]:
    """Yield the file for the output of the process: the terminal, or a log in the run folder."""
    if sys.stderr.isatty():
        yield sys.stderr
    else:
        run.mkdir(parents=True, exist_ok=True)
        with (run / LOG).open("a") as file:
            yield file


def _record_crash(experiment: Experiment, place: Place, code: int) -> None:
    """Record the failure of a process that ended without a record of its own."""
    if code < 0:
        kind = signal.Signals(-code).name
        hint = ", often because memory ran out" if kind == "SIGKILL" else ""
        sentence = f"the process was ended by signal {-code}{hint}; see {place.run(experiment) / LOG}"
    else:
        kind, sentence = "crash", f"the process ended with code {code}; see {place.run(experiment) / LOG}"
    record_failure(experiment, place, "its process", kind, sentence)


def _outcome(experiment: Experiment, status: Status) -> str:
    if status.word != "done" or status.result is None:
        return f"{status.word}  {status.detail}"
    headline = experiment.protocols[0]
    vpt = headline_vpt(status.result["scores"][headline.name])["mean"]
    return f"done  VPT {vpt:.3f} ({headline.name})"


def _note(costs: dict[str, list[float]], experiment: Experiment, status: Status) -> None:
    if status.word == "done" and status.result is not None:
        seconds = status.result["seconds"]
        costs.setdefault(experiment.model, []).append(seconds["training"] + seconds["evaluation"])


def _left(costs: dict[str, list[float]], experiments: Sequence[Experiment]) -> str:
    """Return the time left, from the times of the same model or else of all models; nothing before the first one."""
    known = [cost for model in costs.values() for cost in model]
    if not known or not experiments:
        return ""
    each = [costs.get(experiment.model, known) for experiment in experiments]
    return f", about {_clock(sum(sum(some) / len(some) for some in each))} left"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min {rest:02d} s"
