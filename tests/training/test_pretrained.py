"""The trained models in the package, on recordings of dm_control from the generator of the paper."""

import json
import shutil
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import keycld
from keycld import KeycldError
from keycld.control import Plant
from keycld.systems import get
from keycld.training import load_run, pretrained, run_folder
from keycld.training.checkpoints import latest_checkpoint, read_position

GOLDEN = Path(__file__).parent.parent / "systems" / "golden"
# ε of the validation frames (docs/data.md): with a larger error a frame is no better than the mean picture.
EPSILON = {"pendulum": 8.8e-4, "cartpole": 1.05e-3, "acrobot": 1.98e-3}


def test_there_is_one_for_each_system_of_the_paper():
    assert pretrained() == ("acrobot", "cartpole", "pendulum")


@pytest.mark.parametrize("name", EPSILON)
def test_it_predicts_the_last_frame_from_the_first_two(name):
    golden = np.load(GOLDEN / f"{name}.npz")
    count, length, size = golden["state"].shape
    with Plant(get(name), golden["state"][:, [0, 1, -1]].reshape(-1, size), workers=1) as plant:
        image = jnp.asarray(plant.look().reshape(count, 3, 64, 64, 3), jnp.float32) / 255
    u, dt = jnp.asarray(golden["action"], jnp.float32), jnp.float32(get(name).dt)
    model = keycld.load(name)
    predict = eqx.filter_jit(lambda frames, u: model.predict(frames, dt, u, length).frames[-1])
    error = [float(jnp.mean((predict(frames[:2], v) - frames[-1]) ** 2)) for frames, v in zip(image, u, strict=True)]
    still = np.mean((image[:, 1] - image[:, -1]) ** 2, axis=(1, 2, 3))
    assert np.median(error) < 0.5 * EPSILON[name] < np.median(still)


def test_its_run_folder_is_made_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = run_folder("pendulum")
    model, config = load_run(folder)
    assert config.system == "pendulum" and json.loads((folder / "config.json").read_text())["seed"] == config.seed
    for packed, found in zip(jax.tree.leaves(keycld.load("pendulum")), jax.tree.leaves(model), strict=True):
        np.testing.assert_array_equal(packed, found)
    position = latest_checkpoint(folder) / "position.json"
    position.write_text(json.dumps(read_position(position.parent) | {"weights": "of another version"}))
    (folder / "report.html").write_text("of another version")
    assert run_folder("pendulum") == folder and not (folder / "report.html").exists()
    assert (folder.with_name("pendulum-pretrained.of anoth") / "report.html").read_text() == "of another version"
    with pytest.raises(KeycldError, match="did you mean 'pendulum'"):
        run_folder("pendulm")


def test_damaged_weights_are_refused(tmp_path, monkeypatch):
    shelf = shutil.copytree(Path(keycld.__file__).parent / "weights", tmp_path / "shelf")
    whole = (shelf / "pendulum" / "weights.safetensors").read_bytes()
    (shelf / "pendulum" / "weights.safetensors").write_bytes(whole[: len(whole) // 2])
    # The dotted name is that of the function `pretrained`.
    monkeypatch.setattr(sys.modules["keycld.training.packaged"], "_SHELF", shelf)
    with pytest.raises(KeycldError, match="packaged model 'pendulum' is damaged"):
        keycld.load("pendulum")
