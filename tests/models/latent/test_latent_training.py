"""A latent model in a run folder: trained, cut, resumed, loaded."""

import json
import shutil

import jax
import numpy as np

from keycld.models import config_for
from keycld.training import finished, load_run, train
from scenes import write_data

TINY = {"channels": 4, "hidden": 8, "depth": 1, "latent": 4, "batch": 2, "steps": 6}


def terms(run):
    """What was logged at each step, without the time that it took."""
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    return [{name: value for name, value in line.items() if "seconds" not in name} for line in lines]


def test_a_resumed_run_has_the_same_bits(tmp_path):
    """The multiplier of GECO and its Adam are in the checkpoint too."""
    data = write_data(tmp_path / "mine", count=3, frames=9)
    config = config_for("hgn", "released", **TINY, objective="geco", regime="forward_backward")
    settings = {"checkpoint_seconds": 0.0, "log_every": 2, "keep": 100}
    model = train(data, tmp_path / "whole", config, **settings)
    run = shutil.copytree(tmp_path / "whole", tmp_path / "cut")
    (run / "checkpoints" / "latest").write_text("00-train-000002")
    train(data, run, config, **settings)
    resumed, _ = load_run(run)
    assert finished(run)
    for one, other in zip(jax.tree.leaves(model), jax.tree.leaves(resumed), strict=True):
        np.testing.assert_array_equal(other, one)
    assert terms(run) == terms(tmp_path / "whole")
    multipliers = [line["multiplier"] for line in terms(run) if "multiplier" in line]
    assert multipliers == sorted(multipliers) and multipliers[0] < multipliers[-1]
