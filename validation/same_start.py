"""A bound on valid prediction: the system itself with the model's error of the initial state, next to the model.

python validation/same_start.py RUN [--data FOLDER] [--split test_long] [--frames N]     results/same-start/SYSTEM.json

In a chaotic system the error of the initial state grows, which limits even a prediction with perfect dynamics. The
probe maps the model's initial state to a true one: positions of the first two predicted frames, and their difference as
velocity. The error is the difference from the same quantities of the true states. The system then simulates from the
true state plus that error, and its pictures are scored as a prediction. For systems in MuJoCo, those of the zoo too.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from keycld.data import open_data
from keycld.evaluation import (
    difference,
    fit_probe,
    frame_errors,
    invert_landmarks,
    observed_states,
    predict,
    references,
    valid_prediction_time,
)
from keycld.models.base import HasKeypoints
from keycld.systems import AbstractWatchedMechanism, get
from keycld.training import environment, load_run, run_folder

LENGTHS = (50, 200, 500)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", help="run folder, or a trained model of the package")
    parser.add_argument("--data", type=Path, help="data set; by default the run's own")
    parser.add_argument("--split", default="test_long")
    parser.add_argument("--frames", type=int, help="length of the predictions; by default that of the recordings")
    parser.add_argument("--out", type=Path, default=Path("results/same-start"))
    options = parser.parse_args()

    model, config = load_run(run_folder(options.run))
    data = open_data(options.data or config.data)
    split, system, shared = data.split(options.split), get(config.system), references(data)
    assert isinstance(system, AbstractWatchedMechanism) and isinstance(model, HasKeypoints)
    assert split.image is not None and split.state is not None and shared.angles is not None
    length = min(options.frames or split.frames, split.frames)

    parts = predict(model, split.image[:, : model.context], split.dt, split.input, length)
    predicted, first = [], []
    for _, part in parts:
        assert part.keypoints is not None
        predicted.append(part.frames)
        first.append(part.keypoints[:, :2])
    predicted, first = np.concatenate(predicted), np.concatenate(first)

    guesses = shared.guesses()
    probe = fit_probe(system, *observed_states(model, data, "validation"), guesses, shared.angles)
    probed = invert_landmarks(system, probe.landmarks(first), guesses)
    true = split.state[:, :2, : probed.shape[-1]]
    place = difference(probed[:, 0], true[:, 0], shared.angles)
    rate = (difference(probed[:, 1], true[:, 1], shared.angles) - place) / split.dt
    initial = split.state[:, 0] + np.concatenate([place, rate], axis=-1)

    with system.open_renderer() as renderer:
        runs = [system.simulate(*each, length - 1).state for each in zip(initial, split.input, strict=True)]
        paths = np.concatenate([initial[:, None], runs], axis=1)
        simulated = np.stack([[renderer.render(state) for state in path] for path in paths])

    scores = {}
    for name, pictures in (("model", predicted), ("true physics, same error of the start", simulated)):
        errors = frame_errors(split.image[:, :length], pictures)
        scores[name] = {
            str(n): round(float(np.mean(valid_prediction_time(errors[:, :n], shared.epsilon)) / n), 4)
            for n in LENGTHS
            if n <= length
        }
    error = {
        "positions_rms": np.sqrt(np.mean(place**2, axis=0)).round(5).tolist(),
        "velocities_rms": np.sqrt(np.mean(rate**2, axis=0)).round(5).tolist(),
        "units": list(system.units),
    }
    result = {
        "command": f"python validation/same_start.py {options.run} --split {options.split} --frames {length}",
        "run": {"model": config.model, "preset": config.preset, "seed": config.seed},
        "split": options.split,
        "trajectories": len(initial),
        "vpt": scores,
        "error_of_the_start": error,
        "commit": environment()["commit"],
    }
    path = options.out / f"{config.system.removeprefix('zoo/')}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
