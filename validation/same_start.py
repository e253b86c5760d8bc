"""How far anyone could predict: MuJoCo itself, started with the model's own error of the start, beside the model.

python validation/same_start.py RUN [--data FOLDER] [--split test_long]     results/same-start/SYSTEM.json

Where physics is chaotic, a prediction ends when the error of its start has grown, however good its dynamics are. The
model's start is read as a true state through the probe (positions of its first two predicted frames, their difference
as velocity); the error is what it differs from the same difference of true states. MuJoCo then moves from the true
state plus that error, is drawn, and scored as a prediction.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from keycld.control import Plant
from keycld.data import open_data
from keycld.evaluation import (
    epsilon,
    fit_probe,
    frame_errors,
    invert_landmarks,
    predict,
    references,
    valid_prediction_time,
)
from keycld.evaluation.evaluate import _watch
from keycld.evaluation.geometry import difference
from keycld.systems import get
from keycld.training import environment, load_run, run_folder

LENGTHS = (50, 200, 500)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", help="run folder, or a trained model of the package")
    parser.add_argument("--data", type=Path, help="data set; the run's own unless told")
    parser.add_argument("--split", default="test_long")
    parser.add_argument("--out", type=Path, default=Path("results/same-start"))
    options = parser.parse_args()

    model, config = load_run(run_folder(options.run))
    data = open_data(options.data or config.data)
    split, system, shared = data.split(options.split), get(config.system), references(data)
    threshold, length = epsilon(data.validation().image), split.image.shape[1]

    parts = predict(model, split.image[:, : model.context], data.dt, split.input, length)
    predicted, first = [], []
    for _, part in parts:
        predicted.append(part.frames)
        first.append(part.keypoints[:, :2])
    predicted, first = np.concatenate(predicted), np.concatenate(first)

    guesses = shared.states[:: max(1, len(shared.states) // 2000)]
    probe = fit_probe(system, *_watch(model, data.validation()), guesses, shared.angles)
    read = invert_landmarks(system, probe.landmarks(first), guesses)
    size = read.shape[-1]
    true = split.state[:, :2, :size]
    place = difference(read[:, 0], true[:, 0], shared.angles)
    rate = (difference(read[:, 1], true[:, 1], shared.angles) - place) / data.dt
    start = split.state[:, 0] + np.concatenate([place, rate], axis=-1)

    with Plant(system, start) as plant:
        frames = [plant.look(), *(plant.advance(split.input) for _ in range(length - 1))]
    simulated = np.stack(frames, axis=1)

    scores = {}
    for name, drawn in (("model", predicted), ("true physics, same error of the start", simulated)):
        errors = frame_errors(split.image, drawn)
        scores[name] = {
            str(n): round(float(np.mean(valid_prediction_time(errors[:, :n], threshold)) / n), 4)
            for n in LENGTHS
            if n <= length
        }
    error = {
        "positions_rms": np.sqrt(np.mean(place**2, axis=0)).round(5).tolist(),
        "velocities_rms": np.sqrt(np.mean(rate**2, axis=0)).round(5).tolist(),
        "units": list(system.units),
    }
    result = {
        "command": f"python validation/same_start.py {options.run} --split {options.split}",
        "run": {"model": config.model, "preset": config.preset, "seed": config.seed},
        "split": options.split,
        "trajectories": len(start),
        "vpt": scores,
        "error_of_the_start": error,
        "commit": environment()["commit"],
    }
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / f"{config.system}.json").write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
