"""The facts about each registered model that `keycld models` prints."""

from typing import Any

import equinox as eqx
import jax

from keycld.models.base import Reversible, capabilities
from keycld.models.config import ModelConfig
from keycld.models.registry import models
from keycld.models.scene import Scene

EXAMPLE = Scene(height=32, width=32, inputs=0, frames=256, dt=0.05, trajectories=1000)
"""Sizes of the data at which parameters are counted: those of "Which priors matter?"."""


def listing(scene: Scene = EXAMPLE) -> list[dict[str, Any]]:
    """Return name, family, title, presets, capabilities and number of trained parameters of each model.

    Models are built in their default preset, as shapes only.

    Args:
        scene: sizes of the data at which parameters are counted.
    """
    rows = []
    for name, entry in models().items():
        config = entry.presets[entry.default].completed()
        model = eqx.filter_eval_shape(config.build, scene, jax.random.key(0))
        trained = [stage.labels(model) for stage in config.stages(scene)]
        leaves = zip(jax.tree.leaves(model), *trained, strict=True)
        count = sum(leaf.size for leaf, *groups in leaves if any(groups))
        rows.append(
            {
                "name": name,
                "family": entry.family,
                "title": entry.title,
                "presets": list(entry.presets),
                "capabilities": list(capabilities(model)),
                "parameters": count,
            }
        )
    return rows


def is_reversible(config: ModelConfig) -> bool:
    """Return whether the model of a config runs backward too; it is built as shapes only."""
    return isinstance(eqx.filter_eval_shape(config.completed().build, EXAMPLE, jax.random.key(0)), Reversible)
