"""What a stage does to model and data before its first step, and what it warns of after its last."""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld._errors import KeycldError
from keycld.data import Resident
from keycld.mechanics import Motion, State, fit_motions
from keycld.models.keycld.model import KeyCLD
from keycld.models.keycld.velocity_prior import VelocityPrior

# Mean frame and deviation are those of at least so many trajectories, if there are as many.
_MEASURED = 1000
# Compiled once for all stages that fit.
_fit = eqx.filter_jit(fit_motions)


def measure_statistics(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Put the training data's mean frame and deviation into the estimator and the renderer."""
    mean, deviation = _mean_and_deviation(data)
    if not deviation > 0:
        raise KeycldError("all training pictures are the same: there is no motion to learn from; check the data.")
    model = eqx.tree_at(
        lambda m: (m.estimator.standardise.mean, m.estimator.standardise.deviation, m.renderer.background),
        model,
        (mean, deviation, mean),
    )
    return model, data


def warn_unseen(model: Any, terms: Mapping[str, float]) -> str | None:
    """Return a warning where the vision stage has failed: much of what moves is missing from the rendered pictures.

    Measured: successful stages left 0.05 to 0.08 of the mean picture's error, failed ones 0.27 to 1.0; the later stages
    seldom repair that.
    """
    whole = float(model.estimator.standardise.deviation) ** 2 * model.renderer.background.size
    share = terms["reconstruction"] / whole
    if share < 0.2:
        return None
    return (
        f"the keypoints have not found their parts: {share:.2f} of the mean picture's error is left, where less than "
        "0.1 is usual. Training goes on, but predictions will be poor. Try another --seed, or --vision.steps 2000."
    )


def cache_keypoints(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Add the keypoints that the model's estimator finds in every training frame."""
    count, length = data.image.shape[:2]
    seen = [_observe(model, data.image[i]) for i in range(count)]
    return model, eqx.tree_at(
        lambda d: d.cached, data, jnp.stack(seen).reshape(count, length, -1), is_leaf=lambda x: x is None
    )


def share_constants(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Put the mean of Φ over all cached keypoints into the model, if its trajectories share their constants."""
    if model.initial_state.shared is None:
        return model, data
    assert data.cached is not None
    values = jax.vmap(model.constraint)(data.cached.reshape(-1, data.cached.shape[-1]))
    return eqx.tree_at(lambda m: m.initial_state.constants, model, jnp.mean(values, axis=0)), data


def fit_dynamics(model: Any, data: Resident, *, trajectories: int = 150) -> tuple[Any, Resident]:
    """Fit masses and the affine parts of V and g to the cached keypoints, by least squares through the dynamics.

    Gradient steps on a few clips leave these numbers several per cent off, which decides long predictions; whole
    trajectories, about so many of them, pin them down: some fifty numbers are sought. A model without a Lagrangian is
    left as it is.
    """
    dynamics = model.dynamics
    if not isinstance(model, KeyCLD):
        return model, data

    def free(path: Any, leaf: Any) -> bool:
        return eqx.is_inexact_array(leaf) and "perceptron" not in jax.tree_util.keystr(path)

    assert data.cached is not None
    some = slice(None, None, max(1, len(data.u) // trajectories))
    length = data.image.shape[1]
    horizons = tuple(sorted({min(frames, length) for frames in (length // 4, length // 2, length)}))
    fitted = _fit(
        dynamics,
        jax.tree_util.tree_map_with_path(free, dynamics),
        data.cached[some],
        data.u[some],
        data.dt,
        horizons=horizons,
        constants=model.constants,
    )
    return eqx.tree_at(lambda m: m.dynamics, model, fitted.dynamics), data


def measure_velocity_prior(model: Any, data: Resident, *, trajectories: int = 150) -> tuple[Any, Resident]:
    """Measure the velocity prior on training recordings, from the cached keypoints.

    Of about so many recordings: τ is the time after rest that predicts them best, σ_s² / (σ_s² + σ_b²) the share of the
    way from the observed velocities to those τ after rest that does. The sum is the median of what lies between, so
    that some recordings may have any first velocity. A model without a prior is left as it is.
    """
    if model.velocity_prior is None:
        return model, data
    assert data.cached is not None
    some = slice(None, None, max(1, len(data.u) // trajectories))
    return eqx.tree_at(
        lambda m: m.velocity_prior, model, _velocity_prior(model, data.cached[some], data.u[some], data.dt)
    ), data


def in_turn(*steps: Callable) -> Callable[[Any, Resident], tuple[Any, Resident]]:
    """Return several preparations as one."""

    def prepare(model: Any, data: Resident) -> tuple[Any, Resident]:
        for step in steps:
            model, data = step(model, data)
        return model, data

    return prepare


# Compiled once for all stages, too.
@eqx.filter_jit
def _observe(model: Any, image: jax.Array) -> jax.Array:
    frames = image.astype(jnp.float32) / 255.0
    return jax.vmap(lambda frame: model.observe(frame).keypoints.reshape(-1))(frames)


@eqx.filter_jit
def _velocity_prior(model: Any, seen: jax.Array, u: jax.Array, dt: jax.Array, *, scale: float = 0.03) -> VelocityPrior:
    dynamics, law = model.dynamics, model.dynamics.law
    freedom = law.freedom
    initial = jax.vmap(lambda x, u: model.initial_state(dynamics, x[: model.context], dt, u))(seen, u)
    x, observed = initial.coordinates
    first = u if u.ndim == 2 else u[:, 0]
    acceleration = jax.vmap(lambda x, u: law.acceleration(x, jnp.zeros_like(x), u))(x, first)

    def miss(v: jax.Array) -> jax.Array:
        """Return the error of predictions with these first velocities; diverged ones count little."""
        released = State(Motion(x, v), initial.parameters)
        paths = jax.vmap(lambda state, u: dynamics.rollout(state, u, dt, seen.shape[1] - 1).x)(released, u)
        far = jnp.nan_to_num(jnp.sum((paths - seen) ** 2, axis=-1), nan=1.0, posinf=1.0)
        return jnp.mean(jnp.sqrt(1 + far / scale**2))

    def best(choices: jax.Array, velocities: Any) -> jax.Array:
        return choices[jnp.argmin(jax.lax.map(lambda choice: miss(velocities(choice)), choices))]

    elapsed = best(dt * jnp.linspace(0.0, 3.0, 31), lambda elapsed: elapsed * acceleration)
    off = observed - elapsed * acceleration
    part = best(jnp.linspace(0.0, 1.0, 21), lambda part: observed - part * off)
    # The median of χ² with n degrees of freedom is near n (1 − 2/9n)³.
    variance = jnp.nanmedian(jnp.sum(off**2, axis=-1)) / (freedom * (1 - 2 / (9 * freedom)) ** 3) + 1e-12
    speed = jnp.sqrt(jnp.mean(jnp.sum(jnp.diff(seen, axis=1) ** 2, axis=-1)) / freedom) / dt
    return VelocityPrior(elapsed, jnp.sqrt((1 - part) * variance), jnp.sqrt(part * variance), speed)


def _mean_and_deviation(data: Resident) -> tuple[jax.Array, jax.Array]:
    # One trajectory at a time, in NumPy: uint8 sums stay exact, and no float copy of the data is made.
    count = data.image.shape[0]
    some = range(0, count, max(1, count // _MEASURED))
    mean = np.zeros(data.image.shape[2:])
    for i in some:
        mean += np.asarray(data.image[i]).mean(0) / len(some)
    mean /= 255.0
    variance = np.mean([np.mean((np.asarray(data.image[i]) / 255.0 - mean) ** 2) for i in some])
    return jnp.asarray(mean, jnp.float32), jnp.asarray(np.sqrt(variance), jnp.float32)
