"""One whole file of every kind that the campaign damages."""

import json
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from keycld.benchmarks import Experiment

# Any pose will do as a goal: the model is hardly trained.
_EPSILON = 1.0
_RESULT = "results/keycld/fast/pendulum-keycld-0.json"
AR: dict[str, Any] = {
    "layers": 1,
    "hidden": 8,
    "latent": 4,
    "channels": 8,
    "batch": 2,
    "window": 4,
    "given": 3,
    "steps": 4,
}
"""Settings of a recurrent model whose steps are cheap."""


def make_originals(folder: Path, repository: Path) -> None:
    """Make a small data set, a trained and a half trained run with results, videos, a suite, results of a bench."""
    sys.path.insert(0, str(repository / "tests"))
    data_set(folder)
    trained_run(folder)
    half_run(folder)
    controlled(folder)
    states(folder)
    pictures(folder)
    rig(folder)
    shutil.copytree(repository / "tests/data/golden/tfrecord/matching_pennies", folder / "matching_pennies")
    bench(folder, repository)


def data_set(folder: Path) -> None:
    """Make a data set of a pendulum, with sweeps and statistics."""
    import h5py

    from keycld.data import Trajectories, open_data, read, write
    from keycld.data.describe.statistics import split_statistics
    from scenes import write_data  # pyright: ignore[reportMissingImports]

    write_data(folder / "data")
    for path in (folder / "data").glob("*.h5"):
        with h5py.File(path, "r+") as file:
            file.attrs["system"] = "pendulum"
    (folder / "data/constraints.toml").write_text(
        'keypoints = ["tip"]\n\n[[constraint]]\nkind = "distance_to_point"\nkeypoint = "tip"\npoint = [0.0, 0.0]\n'
    )
    data = open_data(folder / "data")
    image = read(folder / "data/train.h5", rows=slice(0, 1)).image
    assert image is not None
    sweeps = Trajectories(
        time=data.dt * np.arange(1, 6), input=np.zeros((1, 1), np.float32), image=image[:, :5],
        state=np.zeros((1, 5, 2)),
        parameters={"name": np.array(["turn"]), "vary": np.array(["angle"]), "length": np.array([5]),
                    "shape": np.array([[5, 1]])},
        attributes={"system": data.system, "dt": data.dt, "state_names": ("angle", "rate"), "units": ("rad", "rad/s")},
    )  # fmt: skip
    write(folder / "data/sweeps.h5", sweeps)
    splits = {path.stem: split_statistics(path) for path in sorted((folder / "data").glob("*.h5"))}
    recipe = {"system": "mine", "protocol": "own", "splits": []}
    _json(folder / "data/statistics.json", {"splits": splits, "recipe": recipe, "seconds": 1.0, "renderer": "x"})


def trained_run(folder: Path) -> None:
    """Train KeyCLD for some steps, evaluate it, and store energies along a sweep."""
    from keycld.data import open_data, read
    from keycld.evaluation import evaluate, protocol_named, save_evaluation
    from keycld.evaluation.outcome import Evaluation
    from keycld.models import config_for
    from keycld.training import train
    from keycld.training.checkpoints import latest_checkpoint
    from scenes import TINY  # pyright: ignore[reportMissingImports]

    model = train(folder / "data", folder / "run", config_for("keycld", "fast", **TINY), log_every=2)
    newest = latest_checkpoint(folder / "run")
    assert newest is not None
    newest.rename(newest.with_name("C"))
    (folder / "run/checkpoints/latest").write_text("C")
    _json(folder / "run/verdict.json", {"passed": True, "failures": []})
    _json(folder / "run/config.json", _loaded(folder / "run/config.json") | {"epsilon": _EPSILON})
    data = open_data(folder / "data")
    save_evaluation(folder / "run", "test@10", evaluate(model, data, protocol_named("test@10")))
    image = read(folder / "data/train.h5", rows=slice(0, 1)).image
    assert image is not None
    arrays = {
        "names": np.array(["turn"]), "vary": np.array(["angle"]), "units": np.array(["rad"]),
        "turn/values": np.linspace(0, 1, 5)[:, None], "turn/shape": np.array([5]),
        "turn/potential": np.arange(5, dtype=np.float32), "turn/keypoints": np.zeros((5, 1, 2), np.float32),
        "turn/image": image[0, :5],
    }  # fmt: skip
    save_evaluation(folder / "run", "sweeps", Evaluation({"potential_range": {"turn": 4.0}}, arrays))


def half_run(folder: Path) -> None:
    """Train the recurrent model, and go back to the checkpoint in the middle, with the state of the optimiser."""
    from keycld.models import config_for
    from keycld.training import train

    run = folder / "half"
    train(folder / "data", run, config_for("ar", "fast", **AR), log_every=2, checkpoint_seconds=0.0, keep=9)
    [middle] = (run / "checkpoints").glob("*-000002")
    for path in (run / "checkpoints").glob("*-*"):
        if path != middle:
            shutil.rmtree(path)
    middle.rename(middle.with_name("C"))
    (run / "checkpoints/latest").write_text("C")
    (run / "verdict.json").unlink()


def controlled(folder: Path) -> None:
    """Store a goal picture, and the result of a closed-loop run (models of so small pictures control nothing)."""
    from keycld.data import read
    from keycld.drawing import save_image
    from keycld.evaluation import save_evaluation
    from keycld.evaluation.outcome import Evaluation

    image = read(folder / "data/train.h5", rows=slice(0, 1)).image
    assert image is not None
    save_image(folder / "goal.png", image[0, 0])
    scores = {
        "law": "shaping", "law_settings": {"kp": 8.0}, "limit": None, "estimator": "differences", "seconds": 0.2,
        "disturbance": {"noise": 0.0, "dropped": 0.0}, "goal": "image", "inputs": ["torque"], "acting": ["torque"],
        "system": "pendulum", "dt": 0.05, "n": 2, "successes": 1, "settled_seconds": [0.1, None], "seed": 0,
        "largest_input": [1.0], "mean_square_input": [0.5], "mean_mass": 1.0, "frames_not_arrived": 0,
        "step": {"median_ms": 1.0, "p99_ms": 2.0, "worst_ms": 3.0, "period_ms": 50.0, "missed": 0, "frames": 4},
        "passivity": {"largest_rise_median": 0.0, "falling_frames": 1.0},
    }  # fmt: skip
    steps, trials = 4, scores["n"]
    along = np.linspace(0, 1, trials * steps, dtype=np.float32).reshape(trials, steps)
    arrays = {
        "frames": image[0, : steps + 1], "goal_frame": image[0, 0], "x": np.stack([along, along], -1),
        "input": along[..., None], "good": along > 0.5, "kinetic": along, "desired": along[:, ::-1],
        "tilts": np.linspace(0, 1, trials * (steps + 1)).reshape(trials, steps + 1, 1),
    }  # fmt: skip
    save_evaluation(folder / "run", "control-goal-shaping", Evaluation(scores, arrays))


def states(folder: Path) -> None:
    """Make a data set whose pictures are rendered when they are read."""
    from keycld.data import make_data

    make_data("toy/pendulum", folder / "states", runs={"train": 6, "test": 2, "test_long": 2})
    (folder / "states/preview.gif").unlink()


def pictures(folder: Path) -> None:
    """Make videos of several formats."""
    from keycld.drawing import save_movie

    movie = np.random.default_rng(0).integers(0, 255, (30, 16, 24, 3), np.uint8)
    for name in ("swing.mp4", "swing.gif"):
        save_movie(folder / name, movie, fps=25, scale=1)


def rig(folder: Path) -> None:
    """Make the log of a pendulum with a motor, and physical constants of the run as `identify` stores them."""
    from keycld.evaluation import save_physics
    from keycld.evaluation.physics_file import Physics

    dt, angle, rate, lines = 0.02, 0.5, 0.0, ["time,position,torque"]
    for k in range(200):
        torque = 0.3 * np.sin(0.05 * k) + 0.2 * np.sin(0.17 * k)
        lines.append(f"{k * dt:.3f},{angle:.6f},{torque:.6f}")
        rate += dt * (-9.0 * np.sin(angle) - 0.1 * rate + 4.0 * torque)
        angle += dt * rate
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    known = {"value": 1.5, "sigma": 0.1, "unit": "1/s", "identifiable": True, "note": "as the test says"}
    unknown = {"value": None, "sigma": None, "unit": "s", "identifiable": False}
    constants: Any = {"friction of tip": known, "period": unknown}
    rejected: Any = {"springs": {"worth": 0.01, "needed": 0.05}}
    found = Physics(mechanism="pendulum", fps=50.0, constants=constants, rejected=rejected, prediction={})
    save_physics(folder / "run", found)


def bench(folder: Path, repository: Path) -> None:
    """Copy a recorded result, as if it were of today's settings, and a failure of another seed."""
    from keycld.benchmarks import Place, suite_named
    from keycld.benchmarks.results import record_failure

    (folder / _RESULT).parent.mkdir(parents=True)
    done, failed = suite_named("keycld").select(systems=("pendulum",), models=("keycld",), seeds=(0, 1))
    _json(folder / _RESULT, _loaded(repository / _RESULT) | {"config_hash": done.hash()})
    small = small_experiment()
    small.data.make(Place(folder / "bench", folder / "results").data(small))
    record_failure(failed, Place(folder / "bench", folder / "results"), "training", "KeycldError", "no")


def small_experiment() -> "Experiment":
    """Return an experiment that takes seconds."""
    from keycld.benchmarks.experiment import DataRecipe, Experiment
    from keycld.evaluation import protocol_named

    data = DataRecipe("toy/pendulum", "priors", runs=(("train", 6), ("test", 2), ("test_long", 2)))
    return Experiment("small", data, "ar", "fast", 0, (protocol_named("test@10-given-5"),), AR)


def _loaded(path: Path) -> dict:
    return json.loads(path.read_text())


def _json(path: Path, value: object) -> None:
    path.write_text(json.dumps(value))
