"""AR in a run folder: trained, cut, resumed, loaded."""

import shutil

import jax
import numpy as np

from keycld.models import config_for
from keycld.training import finished, load_run, train
from scenes import write_data


def test_a_resumed_run_has_the_same_bits(tmp_path):
    data = write_data(tmp_path / "mine", count=3, frames=9)
    config = config_for("ar", "released", cell="lstm", channels=4, hidden=8, layers=2, latent=4, batch=2, steps=6)
    settings = {"checkpoint_seconds": 0.0, "log_every": 2, "keep": 100}
    model = train(data, tmp_path / "whole", config, **settings)
    run = shutil.copytree(tmp_path / "whole", tmp_path / "cut")
    (run / "checkpoints" / "latest").write_text("00-train-000002")
    train(data, run, config, **settings)
    resumed, _ = load_run(run)
    assert finished(run)
    for one, other in zip(jax.tree.leaves(model), jax.tree.leaves(resumed), strict=True):
        np.testing.assert_array_equal(other, one)
