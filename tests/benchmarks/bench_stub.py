"""The process of one experiment with quick stubs for data, training and scores, which note what they did.

`python bench_stub.py PARENT ROOT RESULTS EXPERIMENT…`, as `keycld.benchmarks.child`. The file ROOT/behaviour.json may
name what happens in the middle of an experiment's training: `raise`, `kill`, `hang`.
"""

import json
import os
import signal
import sys
import time

import numpy as np

from keycld import KeycldError
from keycld._lock import locked
from keycld.benchmarks import child
from keycld.benchmarks.results import condense, write_json
from keycld.evaluation import Evaluation, save_evaluation, statistics, valid_prediction_time

STEPS = 4


def note(place, words):
    with (place.root / "notes.txt").open("a") as file:
        file.write(words + "\n")


def notes(root):
    path = root / "notes.txt"
    return path.read_text().splitlines() if path.exists() else []


TRAIN = {"trajectories": 4, "frames": 50, "bytes": 1, "sha256": "abc"}


def make_data(experiment, place):
    folder = place.data(experiment)
    # On Ray two experiments begin at the same time.
    with locked(place.root / "data.lock", wait=True):
        if (folder / "statistics.json").exists():
            return
        note(place, f"data {folder.name}")
        folder.mkdir(parents=True)
        write(folder / "statistics.json", {"splits": {"train": TRAIN}, "recipe": {"system": folder.name, "splits": []}})


def train_model(experiment, place, member):
    run = place.run(experiment)
    behaviour = place.root / "behaviour.json"
    fate = json.loads(behaviour.read_text()).get(experiment.name) if behaviour.exists() else None
    if not (run / "config.json").exists():
        write_run(experiment, run)
    (run / "checkpoints").mkdir(exist_ok=True)
    if member is not None:
        note(place, f"{experiment.name} is one of {len(member.group.members)}")
    for step in range(STEPS):
        if not (run / "checkpoints" / str(step)).exists():
            note(place, f"step {step} of {experiment.name}")
            (run / "checkpoints" / str(step)).touch()
            (run / "checkpoints" / "latest").write_text(str(step))
        if fate is not None and step == STEPS // 2:
            meet(fate, place)
    write(run / "metrics.jsonl", {"step": STEPS, "seconds": 60.0 + experiment.seed, "cpu_seconds": 90.0, "frames": 100})


def write_run(experiment, run):
    write(run / "config.json", {"settings": experiment.config().settings()})
    machine = {"processor": "stub", "cores": 2, "devices": ["cpu"], "packages": {}, "python": "3"}
    write(run / "environment.json", {"commit": "c0ffee", **machine})


def meet(fate, place):
    if fate == "raise":
        raise KeycldError("the lamp is out: switch it on.\nmore words")
    if fate == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    (place.root / "hanging").touch()
    while True:
        time.sleep(0.05)


def evaluate_model(experiment, place):
    for protocol in experiment.protocols:
        note(place, f"{protocol.name} of {experiment.name}")
        save_evaluation(place.run(experiment), protocol.name, fake_evaluation(protocol, 0.8 + 0.1 * experiment.seed))


def fake_evaluation(protocol, vpt, trajectories=4):
    """Scores in the form of `evaluate`, errors that grow with time, and pictures whose shade grows too."""
    errors = np.geomspace(1e-5, 1e-2, protocol.horizon)[None, :] * np.linspace(0.5, 2.0, trajectories)[:, None]
    stride = -(-protocol.horizon // 250)
    shown = np.arange(0, protocol.horizon, stride)
    shade = np.broadcast_to((shown % 256).astype(np.uint8)[None, :, None, None, None], (2, len(shown), 16, 16, 3))
    summary = statistics(np.full(trajectories, vpt))
    baselines = ("mean image", "frozen frame")
    low = {f"{threshold:g}": {**summary, "mean": 0.2} for threshold in protocol.thresholds}
    scores = {
        "protocol": {
            "name": protocol.name,
            "split": protocol.split,
            "given": protocol.given,
            "horizon": protocol.horizon,
        },
        "n": trajectories,
        "dt": 0.05,
        "vpt": {f"{each:g}": {**summary, "frames": passed(errors, 1e-3 * each)} for each in protocol.thresholds},
        "metric": protocol.metric,
        "direction": protocol.direction,
        "part": list(protocol.part),
        "threshold": 1e-3,
        "mse": 1e-3,
        "epsilon": 1e-3,
        "baselines": {name: {"mse": 1e-2, "vpt": low} for name in baselines},
        "masses": [1.0],
    }
    kind = "mse"
    if protocol.metric == "normalised":
        kind = "normalised_error"
        scores |= {"normalised_error": {"extrapolation": 0.01}, "table_units": {"extrapolation": 33.0}}
    arrays = {kind: errors} | {f"baseline_{kind}_{name.replace(' ', '_')}": errors for name in baselines}
    arrays |= {"truth": shade, "prediction": 255 - shade, "shown_index": shown, "u": np.zeros((2, 1))}
    arrays["time"] = 0.05 * np.arange(protocol.horizon)
    return Evaluation(scores, arrays)


def passed(errors, threshold):
    return valid_prediction_time(errors, threshold).tolist()


def record(experiment, place, vpt, seconds=60.0):
    """Write a run folder and a result with this score under every protocol."""
    run = place.run(experiment)
    for protocol in experiment.protocols:
        save_evaluation(run, protocol.name, fake_evaluation(protocol, vpt))
    make_data(experiment, place)
    write_run(experiment, run)
    write(run / "metrics.jsonl", {"step": STEPS, "seconds": seconds, "cpu_seconds": 0.0, "frames": 1})
    result = condense(experiment, place, {"training": seconds, "evaluation": 1.0})
    write_json(place.result(experiment), result)
    return result


def write(path, value):
    path.write_text(json.dumps(value) + "\n")


if __name__ == "__main__":
    child.make_data, child.train_model, child.evaluate_model = make_data, train_model, evaluate_model
    sys.exit(child.main(sys.argv[1:]))
