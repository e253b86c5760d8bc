"""Pass trajectories through a model in batches of one fixed shape, so that each compiles once."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped, UInt8

from keycld._errors import KeycldError
from keycld.mechanics import Motion, State
from keycld.models.base import AbstractModel

Progress = Callable[[int, int], None]


def batch_size(length: int) -> int:
    """How many trajectories of `length` frames to predict at once.

    A CPU is fastest while a layer's values for all frames fit its caches; an accelerator wants work.
    """
    frames = 128 if jax.default_backend() == "cpu" else 4096
    return max(1, frames // length)


def batches(count: int, size: int) -> Iterator[tuple[np.ndarray, int]]:
    """Index arrays of one length that cover 0 … count − 1, the last filled up, each with its true length."""
    size = min(size, count)
    for start in range(0, count, size):
        index = np.arange(start, start + size)
        yield np.minimum(index, count - 1), min(size, count - start)


def law_of(model: AbstractModel) -> Any | None:
    """The law with energies that moves the model's keypoints; None for models without one."""
    law = getattr(getattr(model, "dynamics", None), "law", None)
    return law if hasattr(law, "potential_energy") and hasattr(law, "kinetic_energy") else None


def mechanical_quantities(model: AbstractModel, states: State) -> dict[str, Float[Array, "T"]]:
    """Energies and the constraint deviation max |Φ(x) − constants| along stacked states; {} without a law."""
    law = law_of(model)
    if law is None or not isinstance(states.coordinates, Motion):
        return {}

    def at(state: State) -> dict[str, Array]:
        x, v = state.coordinates
        found = {"kinetic": law.kinetic_energy(x, v), "potential": law.potential_energy(x)}
        constants = state.parameters.get("constants")
        if constants is not None and constants.shape[0] > 0:
            found["deviation"] = jnp.max(jnp.abs(law.constraint(x, state.parameters) - constants))
        return found

    return jax.vmap(at)(states)


class Predicted(NamedTuple):
    """Predictions of N trajectories, from `predict_batch` as JAX arrays or from `predict` as NumPy ones.

    Attributes:
        frames: `[N, T, H, W, 3]`.
        keypoints: `[N, T, K, 2]` in image-plane units, or None for models without keypoints.
        mechanics: `kinetic`, `potential` and constraint `deviation`, each `[N, T]`; {} without a law.
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
) -> Predicted:
    """Predict N trajectories at once, compiled: `model.predict` under `vmap`.

    Args:
        model: any model.
        frames: the given ones, float in [0, 1].
        dt: seconds between frames.
        u: inputs, constant or one a frame.
        length: frames to predict, the given ones included.
    """

    def one(frames: Array, u: Array) -> Predicted:
        found = model.predict(frames, jnp.asarray(dt, jnp.float32), u, length)
        keypoints = jax.vmap(model.keypoints)(found.states)
        return Predicted(found.frames, keypoints, mechanical_quantities(model, found.states))

    return jax.vmap(one)(jnp.asarray(frames, jnp.float32), jnp.asarray(u, jnp.float32))


def predict(
    model: AbstractModel,
    frames: UInt8[np.ndarray, "N n H W 3"],
    dt: float,
    u: Shaped[np.ndarray, "N *T l"],
    length: int,
    progress: Progress | None = None,
) -> Iterator[tuple[slice, Predicted]]:
    """Predict `length` frames of each trajectory from its given `frames` and inputs, a few at a time.

    Yields:
        which trajectories, and their predictions as NumPy arrays.

    Raises:
        KeycldError: the model needs more frames than are given.
    """
    if frames.shape[1] < model.context:
        raise KeycldError(
            f"this model needs {model.context} given frames, but there are {frames.shape[1]}: "
            "use a protocol that gives more, or longer recordings."
        )
    inputs = u[:, :length] if u.ndim == 3 else u
    done = 0
    for index, count in batches(len(frames), batch_size(length)):
        given = frames[index].astype(np.float32) / np.float32(255.0)
        found = predict_batch(model, given, dt, inputs[index], length)
        yield slice(done, done + count), jax.tree.map(lambda value, n=count: np.asarray(value)[:n], found)
        done += count
        if progress is not None:
            progress(done * length, len(frames) * length)


@eqx.filter_jit
def free_motion(
    model: AbstractModel,
    frames: Shaped[Array | np.ndarray, "N n H W 3"],
    dt: Any,
    u: Shaped[Array | np.ndarray, "N *T l"],
    steps: int,
) -> dict[str, Float[Array, "N T"]]:
    """Energies and constraint deviation of roll-outs from the given frames with the input switched off.

    `u` is the input under which the given frames, uint8, were recorded. {} for models without a law.
    """

    def one(frames: Array, u: Array) -> dict[str, Array]:
        interval = jnp.asarray(dt, jnp.float32)
        start = model.infer(frames.astype(jnp.float32) / 255.0, interval, u)
        still = jnp.zeros(u.shape[-1:], jnp.float32)
        return mechanical_quantities(model, model.rollout(start, interval, still, steps))

    return jax.vmap(one)(jnp.asarray(frames), jnp.asarray(u, jnp.float32))


@eqx.filter_jit
def _observe(model: AbstractModel, frames: Array, heat_maps: bool) -> tuple[Array, Array | None] | None:
    found = jax.vmap(model.observe)(frames)
    return None if found is None else (found.keypoints, found.heat_maps if heat_maps else None)


def observe(
    model: AbstractModel, frames: UInt8[np.ndarray, "M H W 3"], *, heat_maps: bool = False
) -> tuple[Float[np.ndarray, "M K 2"], UInt8[np.ndarray, "M K rows columns"] | None] | None:
    """The keypoints seen in each frame and, if asked for and there, heat maps with each peak at 255; or None."""
    found = []
    for index, count in batches(len(frames), 64):
        seen = _observe(model, jnp.asarray(frames[index], jnp.float32) / 255.0, heat_maps)
        if seen is None:
            return None
        maps = None if seen[1] is None else _bytes(np.asarray(seen[1])[:count])
        found.append((np.asarray(seen[0])[:count], maps))
    keypoints = np.concatenate([points for points, _ in found])
    shown = [maps for _, maps in found if maps is not None]
    return keypoints, np.concatenate(shown) if shown else None


def _bytes(heat_maps: np.ndarray) -> np.ndarray:
    peak = np.maximum(heat_maps.max(axis=(-2, -1), keepdims=True), 1e-30)
    return np.round(255.0 * np.nan_to_num(heat_maps / peak)).astype(np.uint8)
