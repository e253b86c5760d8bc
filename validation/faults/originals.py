"""One whole file of every kind that the campaign damages."""

import contextlib
import json
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

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
WATCH = ("width=8", "substeps=1", "vision.steps=150", "vision.candidates=1", "vision.batch=8", "vision.worst=1e9",
         "dynamics.worst=1e9", "terms=viscous,")  # fmt: skip
"""Settings of the preset clip that train in seconds."""
DEMO = ("width=8", "groups=2", "terms=viscous,", "vision.steps=6", "vision.candidates=1", "vision.batch=4",
        "vision.worst=1e9", "dynamics.steps=6", "dynamics.batch=4", "dynamics.horizons=5,6", "dynamics.worst=1e9",
        "joint.steps=6", "joint.horizons=6,8")  # fmt: skip
"""Settings of the preset fast that train in seconds."""


def make_originals(folder: Path, repository: Path) -> None:
    """Make a small data set, a trained and a half trained run with results, videos, a suite, results of a bench."""
    from keycld._compile_cache import use_compile_cache

    use_compile_cache()
    sys.path.insert(0, str(repository / "tests"))
    data_set(folder)
    trained_run(folder)
    lawful(folder)
    half_run(folder)
    controlled(folder)
    states(folder)
    pictures(folder)
    rig(folder)
    shutil.copytree(repository / "tests/data/golden/tfrecord/matching_pennies", folder / "matching_pennies")
    bench(folder, repository)
    packaged(folder)
    begun_demo(folder)
    watched(folder)


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


def lawful(folder: Path) -> None:
    """Give the run the law of a pendulum, which can be exported: after some steps its friction gives energy."""
    from safetensors.numpy import load_file, save_file

    path = folder / "run/checkpoints/C/weights.safetensors"
    law = {"initial_state.constants": [0.36], "dynamics.law.potential.weight": [0.0, 5.0],
           "dynamics.law.dissipation.terms.viscous.coefficients": [[0.1]]}  # fmt: skip
    save_file(load_file(path) | {name: np.array(value, np.float32) for name, value in law.items()}, path)


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


def packaged(folder: Path) -> None:
    """Unpack the package's pendulum: the small models of the others control nothing."""
    from keycld.control.swing_up import upright_picture
    from keycld.drawing import save_image
    from keycld.systems import AbstractMujocoSystem, get
    from keycld.training import run_folder
    from keycld.training.checkpoints import latest_checkpoint

    with contextlib.chdir(folder):
        run_folder("pendulum").rename("packaged")
    (folder / "runs/.pendulum-pretrained.lock").unlink()
    (folder / "runs").rmdir()
    newest = latest_checkpoint(folder / "packaged")
    assert newest is not None
    newest.rename(newest.with_name("C"))
    (folder / "packaged/checkpoints/latest").write_text("C")
    system = get("pendulum")
    assert isinstance(system, AbstractMujocoSystem)
    save_image(folder / "upright.png", upright_picture(system))


def begun_demo(folder: Path) -> None:
    """Make data in MuJoCo, and the run of a demo up to the last stage of its training."""
    from keycld.cli.settings import parse_setting
    from keycld.data import make_data
    from keycld.models import config_for
    from keycld.training import train

    make_data("pendulum", folder / "mujoco", runs={"train": 4, "validation": 2, "test": 2}, workers=1)
    run, settings = folder / "begun", config_for("keycld", "fast", **dict(parse_setting(text) for text in DEMO))
    train(folder / "mujoco", run, settings, log_every=2, checkpoint_seconds=0.0, keep=99)
    stages = sorted((run / "checkpoints").glob("*-*"))
    shutil.rmtree(stages[-1])
    (run / "checkpoints/latest").write_text(stages[-2].name)
    (run / "verdict.json").unlink()
    # The data as seen from the folder of a case.
    _json(run / "config.json", _loaded(run / "config.json") | {"epsilon": _EPSILON, "data": "work/mujoco"})


def watched(folder: Path) -> None:
    """Make a clip of a swing, and what `watch` makes of it."""
    from cli.test_watch import swing, video  # pyright: ignore[reportMissingImports]
    from keycld.cli.main import main

    video(folder / "clip.mp4", swing())
    code = main(["watch", str(folder / "clip.mp4"), "--mechanism", "pendulum", "--size", "16", "--out",
                 str(folder / "watched"), "--set", *WATCH])  # fmt: skip
    assert code == 0
    # As seen from the folder of a case.
    _json(folder / "watched/config.json", _loaded(folder / "watched/config.json") | {"data": "work/watched/data"})


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
    result = _loaded(repository / _RESULT)
    _json(folder / _RESULT, result | {"config_hash": done.hash()})
    small = small_experiment()
    small.data.make(Place(folder / "bench", folder / "results").data(small))
    place = Place(folder / "bench", folder / "results")
    record_failure(failed, place, "training", "KeycldError", "no")
    [prior] = suite_named("priors").select(systems=("toy/pendulum",), models=("ar",), seeds=(0,))
    named = {each.name: _scored(result["scores"]["test@50"], each.thresholds) for each in prior.protocols}
    curves = dict.fromkeys(named, result["curves"]["test@50"])
    place.result(prior).parent.mkdir(parents=True)
    _json(place.result(prior), result | {"config_hash": prior.hash(), "scores": named, "curves": curves})


def _scored(scores: dict, thresholds: "Sequence[float]") -> dict:
    """Return the scores as those of the suite `priors`, at these thresholds."""
    names = [f"{each:g}" for each in thresholds]
    baselines = {name: dict.fromkeys(names, 0.2) for name in scores["baselines"]}
    vpt = dict.fromkeys(names, next(iter(scores["vpt"].values())))
    return {**scores, "vpt": vpt, "baselines": baselines, "table_units": {"train": 1.0, "extrapolation": 2.0}}


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
