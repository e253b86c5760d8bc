"""What a stage does to model and data before its first step."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld.data import Resident


def measure_statistics(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Puts the training data's mean frame and deviation into the estimator and the renderer."""
    mean, deviation = _mean_and_deviation(data)
    model = eqx.tree_at(
        lambda m: (m.estimator.standardise.mean, m.estimator.standardise.deviation, m.renderer.background),
        model,
        (mean, deviation, mean),
    )
    return model, data


def cache_keypoints(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Adds the keypoints that the model's estimator sees in every training frame."""
    count, length = data.image.shape[:2]
    observe = eqx.filter_jit(_observe)
    seen = [observe(model, data.image[i]) for i in range(count)]
    return model, eqx.tree_at(
        lambda d: d.keypoints, data, jnp.stack(seen).reshape(count, length, -1), is_leaf=lambda x: x is None
    )


def in_turn(*steps: Callable) -> Callable[[Any, Resident], tuple[Any, Resident]]:
    """Several preparations as one."""

    def prepare(model: Any, data: Resident) -> tuple[Any, Resident]:
        for step in steps:
            model, data = step(model, data)
        return model, data

    return prepare


def _observe(model: Any, image: jax.Array) -> jax.Array:
    frames = image.astype(jnp.float32) / 255.0
    return jax.vmap(lambda frame: model.observe(frame).keypoints.reshape(-1))(frames)


def _mean_and_deviation(data: Resident) -> tuple[jax.Array, jax.Array]:
    # In NumPy and one trajectory at a time: uint8 sums stay exact and no float copy of the data is made.
    image = np.asarray(data.image)
    mean = np.zeros(image.shape[2:])
    for trajectory in image:
        mean += trajectory.mean(0) / len(image)
    mean /= 255.0
    variance = np.mean([np.mean((trajectory / 255.0 - mean) ** 2) for trajectory in image])
    return jnp.asarray(mean, jnp.float32), jnp.asarray(np.sqrt(variance), jnp.float32)
