"""The verbs `identify` and `export`."""

import json
import math
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import keycld.training
from keycld.cli.main import main
from keycld.data import Trajectories, write
from keycld.mechanics import Constraints, DistanceToPoint
from keycld.models import Scene, config_for


@pytest.fixture
def log(tmp_path):
    """A driven pendulum without friction, integrated by small steps."""
    q, rate, rows, dt = 0.0, 0.0, ["t,angle,tau"], 1 / 200
    for k in range(1500):
        push = 1.5 * math.sin(0.02 * k + 1e-5 * k * k)
        rows.append(f"{k * dt:.4f},{q:.6f},{push:.6f}")
        for _ in range(10):
            rate += dt / 10 * (push - 2.0 * math.sin(q)) / 0.1
            q += dt / 10 * rate
    path = tmp_path / "rig.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def test_identify_prints_and_stores_the_constants(log, tmp_path, capsys):
    words = ["identify", str(log), "--mechanism", "pendulum", "--position", "angle", "--input", "tau", "--time", "t"]
    assert main([*words, "--out", str(tmp_path / "rig"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "rig" / "evaluation" / "physics.json").read_text())
    assert printed["constants"]["inertia"]["value"] == pytest.approx(0.1, rel=0.03)
    assert printed["constants"]["gravity_torque"]["value"] == pytest.approx(2.0, rel=0.03)


def test_identify_names_a_wrong_column(log, capsys):
    assert main(["identify", str(log), "--mechanism", "pendulum", "--position", "angel", "--time", "t"]) == 2
    assert "did you mean 'angle'?" in capsys.readouterr().err


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A model that is not trained, with the weight of a pendulum of 0.6 units."""
    config = config_for("keycld", "fast", width=8, constraints=Constraints(("bob",), (DistanceToPoint("bob"),)))
    model = config.build(Scene(16, 16, 0, 10, 0.1, 4), jax.random.key(0))
    model = eqx.tree_at(
        lambda m: (m.dynamics.law.potential.weight, m.initial_state.constants),
        model,
        (jnp.array([0.0, 5.0]), jnp.array([0.36])),
    )
    monkeypatch.setattr(keycld.training, "load_run", lambda folder: (model, SimpleNamespace(data="nowhere")))
    (tmp_path / "run").mkdir()
    return tmp_path / "run"


def test_export_writes_a_mujoco_model_with_the_same_period(run):
    mujoco = pytest.importorskip("mujoco")
    assert main(["export", str(run), "--to", "mjcf", "--metres", "0.5"]) == 0
    model = mujoco.MjModel.from_xml_path(str(run / "export.xml"))
    data = mujoco.MjData(model)
    data.qpos[0] = 0.02
    crossings = []
    while len(crossings) < 3:
        before = data.qpos[0]
        mujoco.mj_step(model, data)
        if before > 0 >= data.qpos[0]:
            crossings.append(data.time)
    # Mass 1 at the end of 0.6 units, pulled by 5 units/s².
    assert np.diff(crossings).mean() == pytest.approx(2 * math.pi * math.sqrt(0.6 / 5.0), rel=2e-3)


def test_export_needs_data_for_tracks(run, capsys):
    assert main(["export", str(run), "--to", "csv"]) == 2
    assert "nowhere" in capsys.readouterr().err


def test_export_looks_for_the_data_before_it_writes_the_model(run, capsys):
    assert main(["export", str(run), "--to", "mujoco-sysid"]) == 2
    assert "nowhere" in capsys.readouterr().err and not list(run.iterdir())


def test_exported_tracks_name_their_split_and_inputs(run, tmp_path, capsys):
    attributes = {"system": "mine", "dt": 0.1, "input_names": ("motor torque",)}
    (tmp_path / "data").mkdir()
    image, u = np.zeros((2, 3, 16, 16, 3), np.uint8), np.ones((2, 1), np.float32)
    write(tmp_path / "data" / "test.h5", Trajectories(0.1 * np.arange(3), u, image, attributes=attributes))
    assert main(["export", str(run), "--to", "csv", "--split", "test", "--data", str(tmp_path / "data")]) == 0
    head, *rows = (run / "export-test.csv").read_text().splitlines()
    assert head == "recording,time,keypoint_1_x,keypoint_1_y,motor_torque" and len(rows) == 6
    assert main(["export", str(run), "--to", "csv", "--split", "tset", "--data", str(tmp_path / "data")]) == 2
    assert "unknown split 'tset'" in (told := capsys.readouterr().err) and "did you mean 'test'?" in told


def test_an_export_replaces_no_file_of_the_run(run, capsys):
    (run / "config.json").write_text("{}")
    assert main(["export", str(run), "--to", "mjcf", "--out", str(run / "config.json")]) == 2
    assert (
        "config.json belongs to what is exported, and stays as it is: choose another --out" in capsys.readouterr().err
    )
    assert (run / "config.json").read_text() == "{}"
    assert main(["export", str(run), "--to", "mjcf", "--out", str(run)]) == 2
    assert "run is a folder, and stays as it is: name a file with --out" in capsys.readouterr().err
