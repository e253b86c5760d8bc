"""The process of one experiment, or of several that train together: data, training, scores, result.

`python -m keycld.benchmarks.child PARENT ROOT RESULTS EXPERIMENT…`; `running` has its exit codes.
"""

import contextlib
import os
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

from keycld._files import aside_of, discard_partial, remove_orphans
from keycld._lock import locked
from keycld._records import Name
from keycld._signals import end_on_signals
from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.results import condense, read_json, record_failure, write_json
from keycld.benchmarks.running import DONE, FAILED, INTERRUPTED, TAKEN
from keycld.benchmarks.status import LOCK, LOG, status_of

if TYPE_CHECKING:
    from keycld.training import Member

_NOTES = "bench.json"


def main(arguments: list[str]) -> int:
    """Do the experiments, except those that are done or that other processes do; return an exit code of `running`."""
    parent, root, results, *texts = arguments
    threading.Thread(target=_exit_with, args=(int(parent),), daemon=True).start()
    experiments, place = [Experiment.from_json(text) for text in texts], Place(Path(root), Path(results))
    if len(experiments) == 1:
        return _do(experiments[0], place, None)
    from keycld.training import Together

    with ThreadPoolExecutor(len(experiments)) as threads:
        members = Together(len(experiments)).members
        codes = set(threads.map(lambda experiment, member: _do(experiment, place, member), experiments, members))
    return next(code for code in (FAILED, TAKEN, DONE) if code in codes)


def _do(experiment: Experiment, place: Place, member: "Member | None") -> int:
    try:
        with locked(place.run(experiment) / LOCK) as mine:
            if not mine:
                return TAKEN
            if status_of(experiment, place).word == "done":
                return DONE
            return _attempt(experiment, place, member)
    finally:
        if member is not None:
            member.leave()


def _attempt(experiment: Experiment, place: Place, member: "Member | None") -> int:
    stage = "preparation"
    try:
        notes = _Notes(experiment, place)
        # One of several trainings at a time: each has as many renderer processes as the machine bears.
        turn = contextlib.nullcontext() if member is None else member.turn
        stage = "data"
        with turn, notes.timed(stage):
            make_data(experiment, place)
        stage = "training"
        with notes.timed(stage):
            train_model(experiment, place, member)
        if member is not None:
            member.leave()
        stage = "evaluation"
        with turn, notes.timed(stage):
            evaluate_model(experiment, place)
        stage = "recording"
        write_json(place.result(experiment), condense(experiment, place, notes.seconds))
        place.failure(experiment).unlink(missing_ok=True)
        return DONE
    except Exception as error:
        traceback.print_exc()
        sentence = (str(error).strip().splitlines() or ["no message"])[0]
        record_failure(experiment, place, stage, type(error).__name__, sentence)
        return FAILED


class _Note(TypedDict):
    config_hash: Name
    seconds: dict[str, float]


class _Notes:
    """Notes in a run folder on its experiment: the hash, and the seconds of the processes that were not killed."""

    def __init__(self, experiment: Experiment, place: Place):
        """Read the notes; a run folder of another configuration is moved aside, so that nothing is deleted."""
        self._path = place.run(experiment) / _NOTES
        self._hash = experiment.hash()
        found = read_json(self._path, _Note)
        if found is None or found["config_hash"] != self._hash:
            _set_aside(place.run(experiment), "" if found is None else found["config_hash"])
            found = {"config_hash": self._hash, "seconds": {}}
            write_json(self._path, found)
        self.seconds: dict[str, float] = found["seconds"]

    @contextlib.contextmanager
    def timed(self, what: str) -> Iterator[None]:
        """Add the seconds of the body to those of `what`."""
        before, since = self.seconds.get(what, 0.0), time.monotonic()
        try:
            yield
        finally:
            self.seconds[what] = before + time.monotonic() - since
            write_json(self._path, {"config_hash": self._hash, "seconds": self.seconds})


def _set_aside(run: Path, old: str) -> None:
    """Move the contents of a run folder, except lock and log, to a new one next to it with the old hash in its name.

    What a killed process left hidden is removed: a folder with nothing else is that of a first call.
    """
    remove_orphans(run)
    entries = [entry for entry in run.iterdir() if entry.name not in (LOCK, LOG)]
    if not entries:
        return
    aside = aside_of(run, old)
    aside.mkdir()
    for entry in entries:
        entry.rename(aside / entry.name)


def make_data(experiment: Experiment, place: Place) -> None:
    """Make the data if they are missing; wait while another process makes them."""
    experiment.data.make(place.data(experiment))


def train_model(experiment: Experiment, place: Place, member: "Member | None" = None) -> None:
    """Train to the end, from the newest checkpoint if there is one."""
    from keycld.training import finished, read_verdict, train

    run = place.run(experiment)
    # The verdict is written after the last checkpoint.
    if not finished(run) or read_verdict(run) is None:
        config, minutes = experiment.config(), experiment.minutes
        train(place.data(experiment), run, config, seed=experiment.seed, minutes=minutes, member=member)


def evaluate_model(experiment: Experiment, place: Place) -> None:
    """Score the trained model under each protocol without a result, and evaluate its energies along the sweeps."""
    from keycld.data import open_data
    from keycld.evaluation import evaluate, evaluate_sweeps, references, save_evaluation, summary
    from keycld.training import load_run

    run, dataset = place.run(experiment), open_data(place.data(experiment))
    trained = (run / "checkpoints" / "latest").stat().st_mtime
    wanted = [*(protocol.name for protocol in experiment.protocols), *({"sweeps"} & set(dataset.splits))]
    missing = [name for name in wanted if not _newer(run / "evaluation" / f"{name}.json", trained)]
    if not missing:
        return
    model, _ = load_run(run)
    shared = references(dataset)
    for protocol in experiment.protocols:
        if protocol.name in missing:
            result = evaluate(model, dataset, protocol, shared=shared)
            save_evaluation(run, protocol.name, result)
            print(summary(result.scores), flush=True)
    if "sweeps" in missing:
        save_evaluation(run, "sweeps", evaluate_sweeps(model, dataset))


def _newer(path: Path, moment: float) -> bool:
    return path.exists() and path.stat().st_mtime >= moment


def _exit_with(parent: int) -> None:
    """Exit when `bench run` has been killed, so that the next one finds no process of the old one."""
    while os.getppid() == parent:
        time.sleep(0.2)
    discard_partial()
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    # `bench run`, which the same interrupt reaches, says so.
    end_on_signals()
    sys.exit(main(sys.argv[1:]))
