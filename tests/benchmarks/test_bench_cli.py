"""`keycld bench` through the real command line on tiny pictures, and its messages on mistakes."""

import dataclasses
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from keycld.benchmarks import suite_named
from keycld.cli.main import main
from keycld.data import Trajectories, write
from keycld.data.generate.protocols import splits
from keycld.data.generate.recipes import recipe_for
from keycld.systems import get
from scenes import DT, disc_pendulum, draw

# arXiv v1's recipe, one epoch, with the released code's optimiser.
SHORT = {"width": 8, "epochs": 1, "released_optimiser": True}
SETTINGS = [f"{name}={str(value).lower()}" for name, value in SHORT.items()]
PRESET = ["--preset", "paper", "--set", *SETTINGS]
ONLY = ["--only", "pendulum-node2-0", *PRESET]


def finished_data(folder):
    """Write a complete data set of the pendulum whose pictures show a disc."""
    plan = splits("keycld-2022")
    for k, split in enumerate(plan):
        count = 3 if split.name == "test_long" else 6
        trajectories = disc_pendulum(count, 12 if split.name == "train" else split.frames, seed=k)
        attributes = {**trajectories.attributes, "system": "pendulum"}
        write(folder / f"{split.name}.h5", dataclasses.replace(trajectories, attributes=attributes))
    angle = np.linspace(-np.pi, np.pi, 16)
    parameters = {"name": np.array(["rotation"]), "vary": np.array(["angle"])}
    parameters |= {"length": np.array([16]), "shape": np.array([[16, 1]])}
    state = np.stack([angle, 0 * angle], axis=-1)[None]
    image = draw(0.6 * np.sin(angle), -0.6 * np.cos(angle))[None]
    still = np.zeros((1, 1), np.float32)
    time = DT * np.arange(16)
    sweeps = Trajectories(time, still, image, state, parameters=parameters, attributes=attributes)
    write(folder / "sweeps.h5", sweeps)
    usual = dict.fromkeys(("protocol", "control", "initial_state", "clip", "input", "store", "runs", "frames"))
    recipe = recipe_for(get("pendulum"), size="default", **usual)
    figures = {"trajectories": 6, "frames": 12, "bytes": 1}
    found = {name: figures | {"sha256": name} for name in (*(split.name for split in plan), "sweeps")}
    (folder / "statistics.json").write_text(json.dumps({"splits": found, "recipe": recipe}))


def keycld(*arguments, folder):
    command = [sys.executable, "-m", "keycld.cli.main", *map(str, arguments)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_two_tiny_experiments_from_data_to_page(tmp_path, monkeypatch, capsys):
    """They train together; the first one is looked at."""
    folder = tmp_path / "data" / "pendulum"
    folder.mkdir(parents=True)
    finished_data(folder)
    both = ["--only", "pendulum-node2", "--seeds", "0,1", "--together", "2", *PRESET]
    answer = keycld("bench", "run", "keycld", *both, folder=tmp_path)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert answer.stdout.count("done  VPT 0.") == 2 and answer.stdout.strip().endswith("2 done")
    path, other = sorted((tmp_path / "results" / "keycld").rglob("*.json"))
    result, second = json.loads(path.read_text()), json.loads(other.read_text())
    assert result["together"] == 2 and result["scores"]["test@50"]["mse"] != second["scores"]["test@50"]["mse"]
    (experiment,) = suite_named("keycld").select(
        only="pendulum-node2-0", models=["node2"], preset="paper", settings=SHORT
    )
    assert result["config_hash"] == experiment.hash() and path.parent.name == experiment.group.split("/")[1]
    assert result["settings"]["epochs"] == 1 and result["training"]["frames"] > 0
    metrics = (tmp_path / "runs" / experiment.group / experiment.name / "metrics.jsonl").read_text()
    assert json.loads(metrics.splitlines()[-1])["step"] == 6  # one step a training trajectory
    assert set(result["scores"]) == {"test@50", "validation@50", "test_long@200", "test_long@500"}

    before = path.stat().st_mtime_ns
    monkeypatch.chdir(tmp_path)
    assert main(["bench", "run", "keycld", *ONLY]) == 0
    assert "1 experiments, 1 done, 0 to do" in capsys.readouterr().out
    assert path.stat().st_mtime_ns == before

    monkeypatch.chdir(tmp_path)
    for verb in ("status", "table", "figures", "report"):
        assert main(["bench", verb, "keycld", *ONLY]) == 0
    printed = capsys.readouterr().out
    assert "pendulum-node2-0  done" in printed and "paper: NODE2" in printed and "movie-pendulum-test@50.mp4" in printed
    page = tmp_path / "runs" / experiment.group / "report.html"
    assert "</html>" in page.read_text() and str(page.relative_to(tmp_path)) in printed


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "keycl"], ["unknown suite", "did you mean 'keycld'"]),
        (["status", "keycld", "--models", "fcc"], ["did you mean 'fc'"]),
        (["table", "keycld", "--systems", "pendulum,acrobat"], ["did you mean 'acrobot'"]),
        (["status", "keycld", "--seeds", "0,x"], ["whole numbers", "'x'"]),
        (["run", "keycld", "--seeds", "4294967296"], ["a seed is a number from 0 to", "4294967296"]),
        (["run", "keycld", "--preset", "fats"], ["did you mean 'fast'"]),
        (["run", "keycld", "--together", "0"], ["--together", "at least 1, not 0"]),
        (["run", "keycld", "--together", "2", "--on", "ray"], ["--together", "leave out --on ray"]),
        (["run", "keycld", "--set", "joint_step=2"], ["did you mean 'joint.steps'"]),
        (["status", "keycld", "--only", "pendulum-fx-0"], ["did you mean 'pendulum-fc-0'"]),
        (["stauts", "keycld"], ["did you mean 'status'"]),
        (["table", "keycld", "--results", "nodir"], ["there is no folder nodir", "`keycld bench run keycld`"]),
        (["figures", "priors", "--results", "nodir"], ["there is no folder nodir", "`keycld bench run priors`"]),
        (["report", "zoo", "--results", "nodir"], ["there is no folder nodir", "`keycld bench run zoo`"]),
    ],
)
def test_mistakes_get_one_sentence_and_code_two(monkeypatch, capsys, tmp_path, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert main(["bench", *arguments]) == 2
    message = capsys.readouterr().err
    assert message.startswith("keycld: ") and all(word in message for word in words), message
    assert not any(os.scandir(tmp_path))
