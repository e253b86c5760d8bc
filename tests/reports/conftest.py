import json

import numpy as np
import pytest

import scenes
from keycld import systems
from keycld.data import DataSet, Trajectories, write
from keycld.evaluation import Protocol, evaluate, evaluate_sweeps, load_evaluation, references, save_evaluation
from swing import RADIUS, DiscSystem, Still, Swing


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("disc")
    for k, (name, count, frames) in enumerate(
        (("train", 30, 14), ("validation", 4, 14), ("test", 5, 14), ("test_long", 3, 20))
    ):
        write(folder / f"{name}.h5", scenes.disc_pendulum(count, frames, seed=k))
    angle = np.linspace(-np.pi, np.pi, 16)
    names, shapes = ["rotation", "grid"], [[16, 1], [4, 4]]
    state = np.stack([np.stack([angle, 0 * angle], axis=-1), np.stack([angle, np.tile(angle[:4], 4)], axis=-1)])
    write(
        folder / "sweeps.h5",
        Trajectories(
            time=scenes.DT * np.arange(16),
            input=np.zeros((2, 1), np.float32),
            image=scenes.draw(RADIUS * np.sin(state[..., 0]), -RADIUS * np.cos(state[..., 0])),
            state=state,
            parameters={
                "name": np.array(names), "vary": np.array(["angle", "angle,rate"]),
                "length": np.array([16, 16]), "shape": np.array(shapes),
            },
            attributes=scenes.disc_pendulum(1, 3, seed=0).attributes,
        ),
    )  # fmt: skip
    return DataSet(folder, None)


def _config(folder):
    config = {"system": "disc", "model": "keycld", "preset": "fast", "seed": 0, "settings": {"width": 8}}
    (folder / "config.json").write_text(json.dumps({**config, "command": "keycld train disc --out runs/disc"}))


@pytest.fixture(scope="session")
def run(data, tmp_path_factory):
    """A run folder with everything in it."""
    folder = tmp_path_factory.mktemp("run")
    _config(folder)
    (folder / "environment.json").write_text(json.dumps({"python": "3.11", "packages": {"jax": "0.10"}}))
    lines = [
        {"step": 25 * k, "stage": stage, "seconds": 10.0 * k, "frames": 100 * k, "loss": 2.0 / k, "track": 1.0 / k}
        for k, stage in enumerate(["vision"] * 5 + ["joint-8"] * 5, start=1)
    ]
    (folder / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    systems.names()
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(systems.registry._SYSTEMS, "disc", DiscSystem())
        model, shared = Swing.right(), references(data)
        for protocol in (Protocol("test@14", "test", 14, shown=3), Protocol("long@20", "test_long", 20, shown=2)):
            save_evaluation(folder, protocol.name, evaluate(model, data, protocol, shared=shared))
        save_evaluation(folder, "sweeps", evaluate_sweeps(model, data))
    return folder


@pytest.fixture(scope="session")
def scores(run):
    return load_evaluation(run, "test@14").scores


@pytest.fixture(scope="session")
def plain_run(data, tmp_path_factory):
    """A run of a model without keypoints and energies, without metrics."""
    folder = tmp_path_factory.mktemp("plain")
    _config(folder)
    save_evaluation(folder, "test@14", evaluate(Still(), data, Protocol("test@14", "test", 14, shown=2)))
    save_evaluation(folder, "sweeps", evaluate_sweeps(Still(), data))
    return folder
