"""Recipes that are shortened to a time."""

import importlib
import json
import shutil

import pytest

from keycld._errors import KeycldError
from keycld.models import Scene, config_for, models
from keycld.training import read_config, train
from scenes import write_data

SCENE = Scene(height=32, width=32, inputs=0, frames=256, dt=0.05, trajectories=100)
SMALL = {"channels": 4, "hidden": 8, "latent": 4, "batch": 2, "layers": 1}


def test_all_stages_keep_their_shares_of_fewer_steps():
    hgn = config_for("hgn", "fast").shortened(0.5)
    assert hgn.steps == 1250 and [stage.steps for stage in hgn.stages(SCENE)] == [200, 100, 150, 800]
    keycld = config_for("keycld", "fast").shortened(0.5)
    assert (keycld.vision.steps, keycld.joint.steps, keycld.joint.fit_every, keycld.substeps) == (500, 1000, 400, 4)
    assert config_for("keycld", "paper").shortened(0.25).epochs == 25
    assert config_for("ar", "released").shortened(1e-9).steps == 1


@pytest.mark.parametrize(
    ("name", "preset"), [(name, preset) for name, entry in models().items() for preset in entry.presets]
)
def test_every_preset_can_be_shortened(name, preset):
    config = config_for(name, preset)
    assert config.shortened(0.5) != config and config.shortened(1.0) == config


def test_the_share_is_measured_once(tmp_path, monkeypatch):
    """A resumed run takes as many steps as it began with, however fast the machine is then."""
    data, asked = write_data(tmp_path / "mine"), []

    def fitting(config, scene, resident, minutes, devices):
        asked.append(minutes)
        return 0.001

    training = importlib.import_module("keycld.training.runs")
    real = training.fitting_share
    monkeypatch.setattr(training, "fitting_share", fitting)
    config = config_for("ar", "released", **SMALL, steps=4000)
    train(data, tmp_path / "run", config, minutes=2.0, log_every=1)
    train(data, tmp_path / "run", config, minutes=2.0, log_every=1)
    saved = read_config(tmp_path / "run")
    assert asked == [2.0] and (saved.minutes, saved.share, saved.settings["steps"]) == (2.0, 0.001, 4)
    lines = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert lines[-1]["step"] == 4
    with pytest.raises(KeycldError, match="holds another run"):
        train(data, tmp_path / "run", config, minutes=3.0)
    with pytest.raises(KeycldError, match="--minutes is a positive number, not -1"):
        train(data, tmp_path / "other", config, minutes=-1.0)
    shutil.rmtree(tmp_path / "run")
    monkeypatch.setattr(training, "fitting_share", real)
    train(data, tmp_path / "run", config_for("ar", "released", **SMALL, steps=10**7), minutes=0.01)
    saved = read_config(tmp_path / "run")
    # 0.6 seconds of steps that take a tenth of a millisecond to a tenth of a second each.
    assert 6 <= saved.settings["steps"] <= 6000 and saved.share == pytest.approx(
        saved.settings["steps"] / 1e7, abs=1e-7
    )
