"""How well the learned law gives the accelerations of the true motion."""

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld.evaluation.geometry import positions
from keycld.evaluation.probe import Probe, with_one
from keycld.models.base import HasLagrangian

if TYPE_CHECKING:
    from keycld.data import DataSet
    from keycld.systems import AbstractSystem

_MOST_TRAJECTORIES = 200
_STEP = 1e-3


def acceleration_error(
    model: HasLagrangian,
    probe: Probe,
    fit: tuple[Float[np.ndarray, "M K 2"], Float[np.ndarray, "M d"]],
    data: "DataSet",
    split: str,
) -> float | None:
    """Compute the error of learned accelerations along true motion, as a share of the true ones, root mean squares.

    True positions and velocities of the landmarks are mapped to keypoints by the best affine map, which is fitted on
    the frames of the probe. The law gives the acceleration there, and the probe maps it back to the landmarks.

    Args:
        model: whose law.
        probe: from keypoints to landmarks.
        fit: observed keypoints and true states on the frames of the probe.
        data: the data set.
        split: whose recordings; up to 200 of them.

    Returns:
        The share; None if the recordings have no derivative of the state.
    """
    recordings = data.split(split, images=False, rows=slice(0, _MOST_TRAJECTORIES))
    if recordings.state is None or recordings.state_derivative is None:
        return None
    states, derivatives, u = recordings.state, recordings.state_derivative, recordings.input[:, None]
    if recordings.input.ndim == 3:
        # The derivative at a frame is that with the input before it; none is known before the first.
        states, derivatives, u = states[:, 1:], derivatives[:, 1:], recordings.input[:, :-1]
    state = states.reshape(-1, states.shape[-1])
    derivative = derivatives.reshape(state.shape)
    u = np.broadcast_to(u, (*states.shape[:2], u.shape[-1])).reshape(len(state), -1)
    before, now, after = (probe.system.landmarks(moved(state, derivative, sign * _STEP)) for sign in (-1, 0, 1))
    true = (after - 2 * now + before) / _STEP**2
    x, v = keypoint_motion(probe.system, fit, state, derivative)
    found = np.asarray(_accelerations(model, jnp.asarray(x), jnp.asarray(v), jnp.asarray(u)), np.float64)
    gap = found @ probe.matrix[:-1] - true.reshape(len(state), -1)
    return float(np.sqrt(np.mean(gap**2) / np.mean(true**2)))


def keypoint_motion(
    system: "AbstractSystem",
    fit: tuple[Float[np.ndarray, "M K 2"], Float[np.ndarray, "M d"]],
    state: Float[np.ndarray, "N d"],
    derivative: Float[np.ndarray, "N d"],
) -> tuple[Float[np.ndarray, "N dim"], Float[np.ndarray, "N dim"]]:
    """Return where a model's keypoints are in true states, and their velocities, by the best affine map to them.

    Args:
        system: whose landmarks are mapped.
        fit: observed keypoints and true states on the frames that the map is fitted to.
        state: true states.
        derivative: their rates of change.
    """
    to_keypoints, *_ = np.linalg.lstsq(with_one(system.landmarks(fit[1])), fit[0].reshape(len(fit[0]), -1), rcond=None)
    before, now, after = (system.landmarks(moved(state, derivative, sign * _STEP)) for sign in (-1, 0, 1))
    velocity = (after - before).reshape(len(state), -1) / (2 * _STEP)
    return with_one(now) @ to_keypoints, velocity @ to_keypoints[:-1]


def moved(
    state: Float[np.ndarray, "N d"], derivative: Float[np.ndarray, "N d"], time: float
) -> Float[np.ndarray, "N d"]:
    """Return states with positions a short time later, seconds; to second order."""
    q, (rate, acceleration) = positions(state), np.split(derivative, 2, axis=-1)
    return np.concatenate([q + time * rate + time**2 / 2 * acceleration, state[..., q.shape[-1] :]], axis=-1)


def on_constraints(model: HasLagrangian, x: Array, v: Array) -> tuple[Array, Array]:
    """Return the nearest position and velocity `[2K]` that the model's constraints allow."""
    x = x if model.constants is None else model.law.project_position(x, model.constants)
    return x, model.law.project_velocity(x, v)


@eqx.filter_jit
def _accelerations(model: HasLagrangian, x: Array, v: Array, u: Array) -> Array:
    return jax.vmap(lambda x, v, u: model.law.acceleration(*on_constraints(model, x, v), u))(x, v, u)
