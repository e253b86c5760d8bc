"""Preparations that look at the pictures of the training data alone.

A preparation is a function (model, resident data) → (model, resident data), called before the first step of a stage.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld._errors import KeycldError
from keycld.data import Resident
from keycld.models.keycld.config import MOST_ORDERED
from keycld.models.keycld.exchange import orders
from keycld.models.keycld.losses import unevenness
from keycld.models.keycld.observe import COMPARED, FITTED, chosen, observed_keypoints, spread
from keycld.models.keycld.part_light import PartLight, most_frequent
from keycld.vision import fit_discs, pixel_size, still_background

# Mean frame and deviation are measured on at least so many trajectories, if there are as many.
_MEASURED = 200
# About how many recordings show whether parts are discs, and how many frames of each.
_LOOKED, _SEEN = 24, 5
# Share of the light that discs may leave. Of soft discs in 256 values it is 1 %.
_UNEXPLAINED = 0.03


def measure_statistics(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Put the mean frame and the deviation of the training data into the estimator and the renderer.

    Raises:
        KeycldError: all training frames are the same.
    """
    mean, deviation = _mean_and_deviation(data)
    if not deviation > 0:
        raise KeycldError("all training frames are the same, so there is no motion to learn from: check the data.")
    return _in_front_of(model, mean, deviation), data


def measure_background(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Put what is behind the parts in place of the mean frame, and the deviation from it.

    Of a clip with one motion the mean frame shows the parts where they turn round, faintly.

    Raises:
        KeycldError: all training frames are the same.
    """
    model, data = measure_statistics(model, data)
    frames = np.asarray(data.image).reshape(-1, *data.image.shape[2:])
    found = still_background(frames)
    deviation = np.sqrt(np.mean([np.mean((frame / 255.0 - found) ** 2) for frame in frames]))
    return _in_front_of(model, jnp.asarray(found, jnp.float32), jnp.asarray(deviation, jnp.float32)), data


def name_keypoints(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Exchange the names of keypoints where the constraints then hold much better.

    Keypoints that have found their parts under each other's names cannot change places by gradients: they would have to
    leave their parts. The names are exchanged if this halves the unevenness of the constraints, which symmetric
    mechanisms never reach. Models with one keypoint, or more than six, are returned unchanged, and those whose parts
    exchange their looks.

    Args:
        model: during the vision stage.
        data: the training data.
    """
    if model.exchange:
        return model, data
    x, _ = observed_keypoints(model, data, COMPARED)
    count = x.shape[-1] // 2
    if not 1 < count <= MOST_ORDERED:
        return model, data
    choices = orders(count)
    uneven = _uneven_in_orders(model, x.reshape(-1, count, 2), choices)
    best = jnp.argmin(uneven)
    if not uneven[best] < 0.5 * uneven[0]:
        return model, data
    parts = model.estimator.reordered(choices[best]), model.renderer.reordered(choices[best])
    return eqx.tree_at(lambda m: (m.estimator, m.renderer), model, parts), data


def measure_part_light(model: Any, data: Resident, *, discs: bool = True) -> tuple[Any, Resident]:
    """Measure the background of the light of the parts (`PartLight`), and whether these are soft discs.

    They are if discs leave less than 3 % of the light, and are within a pixel of the keypoints, in the median. A model
    without own parameters looks at the light of discs alone.

    Args:
        model: the model whose parts are looked at.
        data: the training data.
        discs: whether the parts may be discs.
    """
    some, begin, _ = chosen(data, FITTED)
    frames = np.stack([np.asarray(data.image[i][k]) for i, k in zip(some, begin, strict=True)])
    background = jnp.asarray(most_frequent(frames), jnp.float32)
    few = list(zip(some, begin, strict=True))[:: max(1, len(some) // _LOOKED)]
    looked = [_discs(model, data.image[i][k : k + _SEEN], background) for i, k in few]
    away, left = (float(np.median(np.abs(each))) for each in zip(*looked, strict=True))
    away = away / pixel_size(*data.shape[2:4])
    taken = discs and away < 1 and left < _UNEXPLAINED
    print(
        f"light        discs are {away:.2f} pixels from the keypoints and leave {100 * left:.1f} % of the light: "
        f"{'taken' if taken else 'not taken'}",
        flush=True,
    )
    if not taken and model.part_light is None:
        return model, data
    light = PartLight(background, jnp.asarray(float(taken)))
    return eqx.tree_at(lambda m: m.part_light, model, light, is_leaf=lambda x: x is None), data


def _in_front_of(model: Any, background: jax.Array, deviation: jax.Array) -> Any:
    """Return the model that sees the deviations from a background, and renders the parts in front of it."""
    return eqx.tree_at(
        lambda m: (m.estimator.standardise.mean, m.estimator.standardise.deviation, m.renderer.background),
        model,
        (background, deviation, background),
    )


def _mean_and_deviation(data: Resident) -> tuple[jax.Array, jax.Array]:
    # One trajectory at a time, in NumPy: uint8 sums stay exact, and no float copy of the data is made.
    some = spread(data, _MEASURED)
    mean = np.zeros(data.image.shape[2:])
    for i in some:
        mean += np.asarray(data.image[i]).mean(0) / len(some)
    mean /= 255.0
    variance = np.mean([np.mean((np.asarray(data.image[i]) / 255.0 - mean) ** 2) for i in some])
    return jnp.asarray(mean, jnp.float32), jnp.asarray(np.sqrt(variance), jnp.float32)


@eqx.filter_jit
def _uneven_in_orders(model: Any, x: jax.Array, orders: jax.Array) -> jax.Array:
    """Return the sum of U_i for keypoints `[B, K, 2]` in each order `[P, K]`."""

    def uneven(order: jax.Array) -> jax.Array:
        ordered = x[:, order].reshape(len(x), -1)
        return jnp.sum(unevenness(model.located(ordered), ordered)[0])

    return jax.lax.map(uneven, orders)


@eqx.filter_jit
def _discs(model: Any, image: jax.Array, background: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return how far discs are from the keypoints, and the light that they leave."""
    frames = image.astype(jnp.float32) / 255.0
    x = model.observe_clips(frames[None]).keypoints
    found = fit_discs(frames, background, x)
    return found.centres - x, found.left
