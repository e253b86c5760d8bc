"""Running of experiments that are missing, stale or failed, in processes of their own."""

import abc
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.results import record_failure
from keycld.benchmarks.status import LOG, Status, count_states, remove_leftovers, status_of
from keycld.evaluation import headline_vpt

# Exit codes of the process of an experiment.
DONE, FAILED, TAKEN, INTERRUPTED = 0, 3, 75, 130

_CHILD = (sys.executable, "-m", "keycld.benchmarks.child")


class AbstractRunner(abc.ABC):
    """Where experiments run."""

    @abc.abstractmethod
    def each(
        self, experiments: Sequence[Experiment], place: Place, child: Sequence[str]
    ) -> Iterator[tuple[Experiment, float, int]]:
        """Attempt all experiments; yield each one when its attempt has ended.

        Args:
            experiments: to attempt, in this order.
            place: where data, runs and results are.
            child: as in `run_experiments`.

        Yields:
            the experiment, the seconds of the attempt, and the number of experiments that run at the same time.
        """


class Here(AbstractRunner):
    """One after the other, on this machine."""

    def each(
        self, experiments: Sequence[Experiment], place: Place, child: Sequence[str]
    ) -> Iterator[tuple[Experiment, float, int]]:
        """Attempt all experiments, as the abstract method says."""
        for experiment in experiments:
            yield experiment, attempt([experiment], place, child), 1


@dataclass(frozen=True)
class AtOnce(AbstractRunner):
    """Several of one model and preset at a time, in one process in which they take their training steps together.

    For a GPU: `keycld.training.Together` says why.

    Attributes:
        most: how many at a time.
    """

    most: int

    def each(
        self, experiments: Sequence[Experiment], place: Place, child: Sequence[str]
    ) -> Iterator[tuple[Experiment, float, int]]:
        """Attempt all experiments, as the abstract method says."""
        recipes: dict[tuple[str, str], list[Experiment]] = {}
        for experiment in experiments:
            recipes.setdefault((experiment.model, experiment.group), []).append(experiment)
        for alike in recipes.values():
            for first in range(0, len(alike), self.most):
                group = alike[first : first + self.most]
                seconds = attempt(group, place, child)
                for experiment in group:
                    yield experiment, seconds, len(group)


def run_experiments(
    experiments: Sequence[Experiment],
    place: Place,
    *,
    runner: AbstractRunner | None = None,
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
        runner: where they run; by default `Here()`.
        child: the command of experiments; its arguments are the id of this process, the two folders of `place`, and
            the experiments.
        say: is called with a line about each experiment.

    Returns:
        number of experiments in each state at the end (`status_of`).
    """
    for experiment in experiments:
        remove_leftovers(experiment, place)
    before = [status_of(experiment, place) for experiment in experiments]
    costs: dict[str, list[float]] = {}
    for experiment, status in zip(experiments, before, strict=True):
        _note(costs, experiment, status)
    left = [experiment for experiment, status in zip(experiments, before, strict=True) if status.word != "done"]
    say(f"{len(experiments)} experiments, {len(experiments) - len(left)} done, {len(left)} to do{_left(costs, left)}")
    width = max(len(experiment.name) for experiment in experiments)
    waiting = list(left)
    for experiment, seconds, together in (runner or Here()).each(left, place, child) if left else ():
        waiting.remove(experiment)
        status = status_of(experiment, place)
        _note(costs, experiment, status)
        line = f"[{len(left) - len(waiting)}/{len(left)}] {experiment.name:{width}}  {_outcome(experiment, status)}"
        say(f"{line}  {_clock(seconds)}{_left(costs, waiting, together)}")
    return count_states(experiments, place)


def attempt(experiments: Sequence[Experiment], place: Place, child: Sequence[str]) -> float:
    """Do experiments in one process, those that are not done or running; return the seconds that this took.

    Whatever happens to that process is recorded.
    """
    since = time.monotonic()
    left = [each for each in experiments if status_of(each, place).word not in ("done", "running")]
    if left:
        for experiment in left:
            place.failure(experiment).unlink(missing_ok=True)
        code = _do(left, place, child)
        if code not in (DONE, FAILED, TAKEN):
            _record_crash(left, place, code)
    return time.monotonic() - since


def _do(experiments: Sequence[Experiment], place: Place, child: Sequence[str]) -> int:
    texts = [experiment.to_json() for experiment in experiments]
    arguments = [str(os.getpid()), str(place.root), str(place.results), *texts]
    with _output(place.run(experiments[0])) as out:
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
    """Yield the file for the output of the process: the terminal, or a log in the (first) run folder."""
    if sys.stderr.isatty():
        yield sys.stderr
    else:
        run.mkdir(parents=True, exist_ok=True)
        with (run / LOG).open("a") as file:
            yield file


def _record_crash(experiments: Sequence[Experiment], place: Place, code: int) -> None:
    """Record the failure of a process that ended without a record of its own."""
    log = place.run(experiments[0]) / LOG
    see = f"; see {log}" if log.exists() else ""
    if code < 0:
        kind = signal.Signals(-code).name
        hint = ", often because memory ran out" if kind == "SIGKILL" else ""
        sentence = f"the process was ended by signal {-code}{hint}{see}"
    else:
        kind, sentence = "crash", f"the process ended with code {code}{see}"
    for experiment in experiments:
        # One of several that another process has taken runs on.
        if status_of(experiment, place).word not in ("done", "failed", "running"):
            record_failure(experiment, place, "its process", kind, sentence)


def _outcome(experiment: Experiment, status: Status) -> str:
    if status.word != "done" or status.result is None:
        return f"{status.word}  {status.detail}"
    headline = experiment.protocols[0]
    vpt = headline_vpt(status.result["scores"][headline.name])["mean"]
    return f"done  VPT {vpt:.3f} ({headline.name})"


def _note(costs: dict[str, list[float]], experiment: Experiment, status: Status) -> None:
    if status.word == "done" and status.result is not None:
        trained, seconds = status.result["training"]["seconds"], status.result["seconds"]
        costs.setdefault(experiment.model, []).append(trained + seconds["evaluation"])


def _left(costs: dict[str, list[float]], experiments: Sequence[Experiment], together: int = 1) -> str:
    """Return the time left, from the times of the same model or else of all models; nothing before the first one.

    Args:
        costs: seconds of each experiment that is done, by model.
        experiments: what is left.
        together: how many of them run at the same time.
    """
    known = [cost for model in costs.values() for cost in model]
    if not known or not experiments:
        return ""
    each = [costs.get(experiment.model, known) for experiment in experiments]
    return f", about {_clock(sum(sum(some) / len(some) for some in each) / together)} left"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min {rest:02d} s"
