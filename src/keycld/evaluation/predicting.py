"""Pass trajectories through a model in batches of one fixed shape, so that each compiles once."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped, UInt8

from keycld._errors import KeycldError
from keycld.mechanics import State
from keycld.models.base import AbstractModel, HasConstraints, HasEnergies, HasKeypoints

Progress = Callable[[int, int], None]


def batch_size(length: int) -> int:
    """Return how many trajectories of `length` frames to predict at once.

    A CPU is fastest while a layer's values for all frames fit its caches; an accelerator wants work.
    """
    frames = 128 if jax.default_backend() == "cpu" else 4096
    return max(1, frames // length)


def batches(count: int, size: int) -> Iterator[tuple[np.ndarray, int]]:
    """Yield index arrays of length `size` that cover 0 … count − 1, the last filled up, each with its true length."""
    for first in range(0, count, size):
        index = np.arange(first, first + size)
        yield np.minimum(index, count - 1), min(size, count - first)


def mechanical_quantities(model: AbstractModel, states: State) -> dict[str, Float[Array, "T"]]:
    """Compute what mechanics a model knows along stacked states.

    Returns:
        `kinetic` and `potential` of a model with energies, `deviation` max |Φ(x) − constants| of one with constraints.
    """
    found = {}
    if isinstance(model, HasEnergies):
        found["kinetic"] = jax.vmap(model.kinetic_energy)(states)
        found["potential"] = jax.vmap(model.potential_energy)(states)
    if isinstance(model, HasConstraints):
        deviation = jax.vmap(model.constraint_deviation)(states)
        if deviation.shape[1] > 0:
            found["deviation"] = jnp.max(jnp.abs(deviation), axis=1)
    return found


class Predicted(NamedTuple):
    """Predictions of N trajectories, from `predict_batch` as JAX arrays or from `predict` as NumPy ones.

    Attributes:
        frames: `[N, T, H, W, 3]`.
        keypoints: `[N, T, K, 2]` in image-plane units, or None for models without keypoints.
        mechanics: `kinetic`, `potential` and constraint `deviation`, each `[N, T]`, as far as the model knows them.
    """

    frames: Any
    keypoints: Any
    mechanics: dict[str, Any]


@eqx.filter_jit
def predict_batch(
    model: AbstractModel,
    frames: Shaped[Array | np.ndarray, "N n H W 3"],
    dt: Any,
    u: Shaped[Array | np.ndarray, "N *T l"],
    length: int,
    first: int = 0,
) -> Predicted:
    """Predict N trajectories at once, compiled: `model.predict` under `vmap`.

    Args:
        model: any model.
        frames: the given ones, float in [0, 1].
        dt: seconds between frames.
        u: inputs, constant or one a frame, from frame 0 on.
        length: frames to predict, the given ones included.
        first: number of the first given frame; above 0 for a `Reversible` model only.
    """

    def one(frames: Array, u: Array) -> Predicted:
        found = model.predict(frames, jnp.asarray(dt, jnp.float32), u, length, first)
        keypoints = jax.vmap(model.keypoints)(found.states) if isinstance(model, HasKeypoints) else None
        return Predicted(found.frames, keypoints, mechanical_quantities(model, found.states))

    return jax.vmap(one)(jnp.asarray(frames, jnp.float32), jnp.asarray(u, jnp.float32))


def predict(
    model: AbstractModel,
    frames: UInt8[np.ndarray, "N n H W 3"],
    dt: float,
    u: Shaped[np.ndarray, "N *T l"],
    length: int,
    progress: Progress | None = None,
    *,
    first: int = 0,
    batch: int | None = None,
) -> Iterator[tuple[slice, Predicted]]:
    """Predict `length` frames of each trajectory from its given `frames` and inputs, a few at a time.

    Args:
        model: any model.
        frames: the given ones.
        dt: seconds between frames.
        u: inputs, constant or one a frame, from frame 0 on.
        length: frames to predict, the given ones included.
        progress: called with the number of frames predicted and their total.
        first: number of the first given frame; above 0 for a `Reversible` model only.
        batch: trajectories at a time, the last ones filled up; what suits the machine by default.

    Yields:
        which trajectories, and their predictions as NumPy arrays.

    Raises:
        KeycldError: the model needs more frames than are given, or cannot run backward.
    """
    refuse_too_few(model, frames.shape[1])
    inputs = u[:, :length] if u.ndim == 3 else u
    done = 0
    for index, count in batches(len(frames), batch or min(len(frames), batch_size(length))):
        given = frames[index].astype(np.float32) / np.float32(255.0)
        found = predict_batch(model, given, dt, inputs[index], length, first)
        yield slice(done, done + count), jax.tree.map(lambda value, n=count: np.asarray(value)[:n], found)
        done += count
        if progress is not None:
            progress(done * length, len(frames) * length)


def refuse_too_few(model: AbstractModel, given: int) -> None:
    """Raise KeycldError where a model needs more given frames."""
    if given < model.context:
        raise KeycldError(
            f"this model needs {model.context} given frames, but there are {given}: use a protocol that gives more, or "
            "longer recordings."
        )


@eqx.filter_jit
def _free_motion(model: AbstractModel, frames: Array, dt: Array, u: Array, steps: int) -> dict[str, Array]:
    def one(frames: Array, u: Array) -> dict[str, Array]:
        initial = model.infer(frames.astype(jnp.float32) / 255.0, dt, u)
        off = jnp.zeros(u.shape[-1:], jnp.float32)
        return mechanical_quantities(model, model.rollout(initial, dt, off, steps))

    return jax.vmap(one)(frames, u)


def free_motion(
    model: AbstractModel,
    frames: UInt8[np.ndarray, "N n H W 3"],
    dt: float,
    u: Shaped[np.ndarray, "N *T l"],
    steps: int,
    *,
    batch: int | None = None,
) -> dict[str, Float[np.ndarray, "N T"]]:
    """Compute energies and constraint deviation of roll-outs from the given frames with the input switched off.

    `u` is the input under which the given frames were recorded. The result is {} for models without energies and
    constraints.
    """
    if not isinstance(model, HasEnergies | HasConstraints):
        return {}
    interval, found = jnp.asarray(dt, jnp.float32), []
    for index, count in batches(len(frames), batch or len(frames)):
        part = _free_motion(model, jnp.asarray(frames[index]), interval, jnp.asarray(u[index], jnp.float32), steps)
        found.append({name: np.asarray(value)[:count] for name, value in part.items()})
    return {name: np.concatenate([part[name] for part in found]) for name in found[0]}


@eqx.filter_jit
def _observe(model: HasKeypoints, frames: Array, heat_maps: bool) -> tuple[Array, Array | None]:
    found = jax.vmap(model.observe)(frames)
    return found.keypoints, found.heat_maps if heat_maps else None


def observe(
    model: HasKeypoints, frames: UInt8[np.ndarray, "M H W 3"], *, heat_maps: bool = False
) -> tuple[Float[np.ndarray, "M K 2"], UInt8[np.ndarray, "M K rows columns"] | None]:
    """Return the keypoints observed in each frame and, if asked for and there, heat maps with each peak at 255."""
    found = []
    for index, count in batches(len(frames), min(len(frames), 64)):
        keypoints, maps = _observe(model, jnp.asarray(frames[index], jnp.float32) / 255.0, heat_maps)
        found.append((np.asarray(keypoints)[:count], None if maps is None else _bytes(np.asarray(maps)[:count])))
    shown = [maps for _, maps in found if maps is not None]
    return np.concatenate([points for points, _ in found]), np.concatenate(shown) if shown else None


def _bytes(heat_maps: np.ndarray) -> np.ndarray:
    peak = np.maximum(heat_maps.max(axis=(-2, -1), keepdims=True), 1e-30)
    return np.round(255.0 * np.nan_to_num(heat_maps / peak)).astype(np.uint8)
