"""How many steps of a recipe fit into a time."""

import time
from typing import Any

import jax

from keycld.data import Resident
from keycld.models import ModelConfig, Scene
from keycld.models.base import AbstractModel
from keycld.stages import Stage
from keycld.training.devices import Devices
from keycld.training.step import initial_progress, make_step

_STEPS, _DISPATCHES = 10, 2


def fitting_share(config: ModelConfig, scene: Scene, data: Resident, minutes: float, devices: Devices) -> float:
    """Return the share of a recipe's steps that take this time, 1 at most.

    Thirty steps of each stage are taken with random weights and forgotten, and the last twenty are timed. The time is
    that of the steps alone: compiling, fits between steps and scores come on top. `config.shortened(share)` is then the
    config whose horizons and rates pass through the same shares of fewer steps.

    Args:
        config: the whole recipe.
        scene: sizes of the data.
        data: training data that are resident at first.
        minutes: wall-clock, on this machine as it is now.
        devices: share the clips of each step.
    """
    model = config.build(scene, jax.random.key(0))
    seconds = sum(_seconds(stage, model, data, devices) for stage in config.stages(scene) if stage.steps)
    return min(1.0, 60.0 * minutes / seconds) if seconds else 1.0


def _seconds(stage: Stage, model: AbstractModel, data: Resident, devices: Devices) -> float:
    """Return the time of all steps of a stage, those of the trials of other initial weights too."""
    prepared, resident = (model, data) if stage.prepare is None else stage.prepare(model, data)
    progress, rest = initial_progress(stage, prepared)
    fixed: Any = devices.everywhere((rest, resident))
    run = make_step(stage, 0, 0, _STEPS, devices)
    progress, _ = run(fixed, devices.everywhere(progress))
    jax.block_until_ready(progress.parameters)
    since = time.monotonic()
    for _ in range(_DISPATCHES):
        progress, _ = run(fixed, progress)
    jax.block_until_ready(progress.parameters)
    trials = (stage.candidates - 1) * min(stage.trial, stage.steps)
    return (time.monotonic() - since) / (_STEPS * _DISPATCHES) * (stage.steps + trials)
