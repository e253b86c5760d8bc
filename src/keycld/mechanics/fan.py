"""Predictions with their error: what a few given frames and uncertain parameters leave open about later frames."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from keycld._errors import KeycldError
from keycld.mechanics.estimate import Estimate, NormalEquations
from keycld.mechanics.sensitivity import sensitivity
from keycld.mechanics.state import Motion

_STEPS = 10


class Fan(NamedTuple):
    """A predicted motion and its standard errors.

    Attributes:
        keypoints: predicted positions `[T, K, 2]`, image-plane units; the given frames are the first ones.
        sigma: standard errors of these positions `[T, K, 2]`. An observation differs by its own noise in addition.
        noise: standard deviation of an observed coordinate of each keypoint `[K]`.
    """

    keypoints: Float[np.ndarray, "T K 2"]
    sigma: Float[np.ndarray, "T K 2"]
    noise: Float[np.ndarray, "K"]


def predict_fan(
    found: Estimate,
    given: Float[np.ndarray, "n dim"],
    u: Float[np.ndarray, "*T l"],
    frames: int,
    *,
    initial: Motion,
) -> Fan:
    """Predict a motion from its first frames, with the errors of initial state and parameters carried along.

    The initial state z is fitted to the given frames. To first order the error of the prediction is

        δx = Z (Zₙᵀ W Zₙ)⁻¹ Zₙᵀ W e + (∂x/∂η − Z ∂z/∂η) δη,    Z = ∂x/∂z

    with e the noise of the given frames, δη the error of the parameters, and ∂z/∂η how the fitted state follows
    them. Errors of keypoints that return with the place have no part in δη: they are the same in what is predicted.
    The given frames are not among those of the estimate, so both are independent. Where the motion is chaotic, σ grows
    exponentially, and the linear result holds as long as it is small.

    Args:
        found: parameters and their covariance.
        given: observed positions of the first n frames.
        u: input, constant `[l]` or `[≥ frames − 1, l]`.
        frames: T, with the given ones.
        initial: a guess of the initial state, `[dim]` each.

    Raises:
        KeycldError: fewer than two given frames, or the prediction diverges.
    """
    count, dim = given.shape
    if not 2 <= count <= frames:
        raise KeycldError(f"a prediction needs 2 to {frames} given frames, not {count}.")
    sigma = np.repeat(found.noise, 2)
    with jax.enable_x64(True):
        inputs = jnp.asarray(np.asarray(u, float))[None]
        start = Motion(*(jnp.asarray(np.asarray(part, float))[None] for part in initial))
        for _ in range(_STEPS):
            near = sensitivity(found.unknowns, found.eta, start, inputs, found.dt, count)
            normal = _normal(near.slopes, near.x - given[None], sigma, near.local)
            start = near.moved(normal.alone)
            if normal.alone[0] @ normal.inner[0] @ normal.alone[0] < 1e-4:
                break
        whole = sensitivity(found.unknowns, found.eta, start, inputs, found.dt, frames)
    if not np.all(np.isfinite(whole.slopes)):
        raise KeycldError("the prediction diverges, so that it has no error bars: predict fewer frames.")
    normal = _normal(whole.slopes[:, :count], whole.x[:, :count] - given[None], sigma, whole.local)
    by_start, by_eta = whole.slopes[0, ..., : whole.local], whole.slopes[0, ..., whole.local :]
    effect = by_eta - by_start @ normal.follow[0]
    # Errors that last for several frames average out less.
    of_start = np.linalg.inv(normal.inner[0]) * float(np.mean(found.inefficiency))
    variance = np.einsum("tdi,ij,tdj->td", by_start, of_start, by_start)
    variance += np.einsum("tdi,ij,tdj->td", effect, found.covariance - found.uneven, effect)
    shape = (frames, dim // 2, 2)
    return Fan(whole.x[0].reshape(shape), np.sqrt(np.maximum(variance, 0.0)).reshape(shape), found.noise)


def _normal(slopes: np.ndarray, off: np.ndarray, sigma: np.ndarray, local: int) -> NormalEquations:
    return NormalEquations(slopes / sigma[:, None], -off / sigma, np.ones(off.shape), local)
