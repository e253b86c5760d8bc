"""What a stage does to model and data before its first step."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld._errors import KeycldError
from keycld.data import Resident
from keycld.mechanics import ConstrainedLagrangian, fit_motions, joining_velocity
from keycld.models import Beginning, shared_constants

# Compiled once for all stages that fit.
_fit = eqx.filter_jit(fit_motions)


def measure_statistics(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Puts the training data's mean frame and deviation into the estimator and the renderer."""
    mean, deviation = _mean_and_deviation(data)
    if not deviation > 0:
        raise KeycldError("all training pictures are the same: there is no motion to learn from; check the data.")
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


def share_constants(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Puts the mean of Φ over all cached keypoints into a start that shares the constants between trajectories."""
    if shared_constants(model) is None:
        return model, data
    assert data.keypoints is not None
    values = jax.vmap(model.constraint)(data.keypoints.reshape(-1, data.keypoints.shape[-1]))
    return eqx.tree_at(lambda m: m.start.constants, model, jnp.mean(values, axis=0)), data


def fit_dynamics(model: Any, data: Resident, *, trajectories: int = 150) -> tuple[Any, Resident]:
    """Least squares through the dynamics: masses and the affine parts of V and g from the cached keypoints.

    Gradient steps on a few clips leave these numbers several per cent off, which decides long predictions; whole
    trajectories, about so many of them, pin them down: some fifty numbers are sought. A model without a Lagrangian is
    left as it is.
    """
    dynamics = model.dynamics
    if not isinstance(getattr(dynamics, "law", None), ConstrainedLagrangian):
        return model, data

    def free(path: Any, leaf: Any) -> bool:
        return eqx.is_inexact_array(leaf) and "perceptron" not in jax.tree_util.keystr(path)

    assert data.keypoints is not None
    some = slice(None, None, max(1, len(data.u) // trajectories))
    length = data.image.shape[1]
    horizons = tuple(sorted({min(frames, length) for frames in (length // 4, length // 2, length)}))
    fitted = _fit(
        dynamics,
        jax.tree_util.tree_map_with_path(free, dynamics),
        data.keypoints[some],
        data.u[some],
        data.dt,
        horizons=horizons,
        constants=shared_constants(model),
    )
    return eqx.tree_at(lambda m: m.dynamics, model, fitted.dynamics), data


def measure_beginning(model: Any, data: Resident, *, trajectories: int = 150, frames: int = 24) -> tuple[Any, Resident]:
    """Puts into the model what training recordings begin with, and how well its sightings tell that.

    About so many recordings: the first velocity as `model.start` sees it, as the motion has it that passes best through
    so many frames, and as it would be τ after rest. Three differences of three estimates tell the variance of each.
    Medians, so that some recordings may begin otherwise, and some motions be lost. From the cached keypoints; a model
    without a prior is left as it is.
    """
    if model.beginning is None:
        return model, data
    assert data.keypoints is not None
    some, last = slice(None, None, max(1, len(data.u) // trajectories)), min(frames, data.image.shape[1])
    seen, u, nothing = data.keypoints[some], data.u[some], jax.tree.map(lambda _: False, model.dynamics)
    horizons = tuple(sorted({max(2, last // 2), last}))
    fitted = _fit(model.dynamics, nothing, seen, u, data.dt, horizons=horizons, constants=shared_constants(model))
    return eqx.tree_at(lambda m: m.beginning, model, _beginning(model, seen, fitted.paths, u, data.dt)), data


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


@eqx.filter_jit
def _beginning(model: Any, seen: jax.Array, paths: jax.Array, u: jax.Array, dt: jax.Array) -> Beginning:
    dynamics, law = model.dynamics, model.dynamics.law
    freedom = seen.shape[-1] - law.count

    def velocities(x: jax.Array, path: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        first = u if u.ndim == 1 else u[0]
        sighted = model.start(dynamics, x[: model.context], dt, u).coordinates.v
        held = {"constants": law.constraint(path[0])}
        fitted = joining_velocity(dynamics, path[0], path[1], held, first, dt)
        return sighted, fitted, law.acceleration(path[0], jnp.zeros_like(fitted), first)

    def variance(errors: jax.Array) -> jax.Array:
        """Of a component, from the median of the squared lengths: that of χ² with n degrees is near n (1 − 2/9n)³."""
        return jnp.median(jnp.sum(errors**2, axis=-1)) / (freedom * (1 - 2 / (9 * freedom)) ** 3)

    sighted, fitted, acceleration = jax.vmap(velocities)(seen, paths, u)
    elapsed = jnp.median(jnp.sum(fitted * acceleration, axis=-1) / jnp.sum(acceleration**2, axis=-1))
    rest = elapsed * acceleration
    whole, spread = variance(sighted - rest), variance(fitted - rest)
    spread = jnp.clip((whole + spread - variance(sighted - fitted)) / 2, 1e-4 * whole, whole)
    speed = jnp.sqrt(jnp.mean(jnp.sum(jnp.diff(seen, axis=1) ** 2, axis=-1)) / freedom) / dt
    return Beginning(elapsed, jnp.sqrt(spread), jnp.sqrt(whole - spread), speed)


def _mean_and_deviation(data: Resident) -> tuple[jax.Array, jax.Array]:
    # In NumPy and one trajectory at a time: uint8 sums stay exact and no float copy of the data is made.
    image = np.asarray(data.image)
    mean = np.zeros(image.shape[2:])
    for trajectory in image:
        mean += trajectory.mean(0) / len(image)
    mean /= 255.0
    variance = np.mean([np.mean((trajectory / 255.0 - mean) ** 2) for trajectory in image])
    return jnp.asarray(mean, jnp.float32), jnp.asarray(np.sqrt(variance), jnp.float32)
