"""Trackers, next to `metrics.jsonl`."""

import sys
import types

import pytest

from keycld import KeycldError
from keycld.training import train
from keycld.training.trackers import make_tracker


def test_tensorboard_shows_the_steps_of_a_killed_and_resumed_training_once(tmp_path, monkeypatch):
    shown = {}

    class SummaryWriter:
        def __init__(self, folder, purge_step):
            self.shown = shown.setdefault(folder, [])
            self.shown[:] = [each for each in self.shown if each[1] < purge_step]

        def add_scalar(self, name, value, step):
            self.shown.append((name, step, value))

        def close(self):
            pass

    monkeypatch.setitem(sys.modules, "tensorboardX", types.SimpleNamespace(SummaryWriter=SummaryWriter))
    for attempt, steps in enumerate([(2, 4, 6), (4, 6, 8), ()]):
        tracker = make_tracker("tensorboard", tmp_path, {})
        for step in steps:
            tracker.log(step, {"loss": float(attempt)})
        tracker.close()
    assert shown == {str(tmp_path / "tensorboard"): [("loss", 2, 0), ("loss", 4, 1), ("loss", 6, 1), ("loss", 8, 1)]}


def test_a_tracker_that_is_not_installed_is_refused_before_there_is_a_run_folder(tmp_path, monkeypatch):
    """Or the same command with other settings would be refused, as those of another run."""
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(KeycldError, match=r"--track wandb needs its package: pip install 'keycld\[wandb\]'"):
        train(tmp_path / "data", tmp_path / "run", track="wandb")
