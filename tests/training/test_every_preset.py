"""Each preset of each registered model takes a training step, at the smallest sizes that its settings allow."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.data import Resident
from keycld.models import Scene, config_for, models
from keycld.training.step import initial_progress, make_step
from scenes import disc_pendulum

SMALL = {
    "width": 8, "channels": 8, "hidden": 12, "depth": 1, "latent": 4, "layers": 2, "batch": 2, "targets": 3,
    "window": 4, "horizons": (6,), "shares": (0.5,), "given": 3, "integrator": "rk2", "candidates": 1, "steps": 1,
    "epochs": 1,
}  # fmt: skip
"""Settings by name, wherever a config or one of its groups has one of that name.

Adaptive integration compiles for many seconds, so one test of its own is enough: that of its gradient.
"""
EVERY = [
    pytest.param(name, preset, marks=() if preset == "fast" else pytest.mark.slow)
    for name, entry in models().items()
    for preset in entry.presets
]


def smallest(config):
    known = {field.name: getattr(config, field.name) for field in dataclasses.fields(config)}
    groups = {name: smallest(value) for name, value in known.items() if dataclasses.is_dataclass(value)}
    return groups | {name: SMALL[name] for name in known if name in SMALL}


@pytest.mark.parametrize(("name", "preset"), EVERY)
def test_one_step(name, preset):
    """Of the first stage: its loss is finite and its gradient reaches the optimiser."""
    config = config_for(name, preset).completed()
    config = config.changed(smallest(config))
    recorded = disc_pendulum(3, 8, seed=0)
    height = recorded.image.shape[2]
    scene = Scene(height, height, 1, 8, 0.05, 3)
    data = Resident(jnp.asarray(recorded.image), jnp.asarray(recorded.input), jnp.array(0.05))
    stage, *_ = config.stages(scene)
    model = config.build(scene, jax.random.key(0))
    if stage.prepare is not None:
        model, data = stage.prepare(model, data)
    progress, rest = initial_progress(stage, model)
    progress, terms = make_step(stage, 0, 0, 1)((rest, data), progress)
    assert bool(progress.healthy) and np.isfinite(float(terms["loss"][0]))
    # Not the weights: the rate of a first step may be zero.
    momenta = [leaf for leaf in jax.tree.leaves(progress.optimiser) if eqx.is_inexact_array(leaf)]
    assert any(np.asarray(leaf).any() for leaf in momenta)
