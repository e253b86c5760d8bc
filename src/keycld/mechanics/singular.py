"""Constraints whose first derivative allows motions that they forbid, so that eq. (6) is wrong."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from keycld.mechanics.constraints import AbstractConstraint

# Singular values of DΦ, with rows of length 1, below this are zero: observed positions are off by a hundredth.
_ZERO = 0.05
# Second derivatives along allowed velocities, as a share of the largest of all, that are no error of positions.
_BENT = 0.2


def is_singular(phi: AbstractConstraint, x: Float[Array, "M dim"]) -> bool:
    """Return whether Φ is singular at most of some positions.

    Where rows of DΦ depend on each other, λᵀDΦ = 0, a velocity v with DΦ v = 0 is possible only if also
    λᵀ⟨D²Φ, v⟩v = 0. A constraint that repeats others passes. Three points in one line, held by distances alone, do not:
    to first order each may turn by itself, so eq. (6) lets them.

    Args:
        phi: Φ.
        x: positions, image-plane units.
    """
    slopes, bends = (np.asarray(each, float) for each in _derivatives(phi, x))
    if not slopes.shape[1]:
        return False
    length = np.maximum(np.linalg.norm(slopes, axis=-1), 1e-9)
    slopes, bends = slopes / length[..., None], bends / length[..., None, None]
    return bool(np.mean([_bent(*each) for each in zip(slopes, bends, strict=True)]) > 0.5)


def turns_within(phi: AbstractConstraint, x: Float[Array, "M dim"], step: float) -> list[int]:
    """Return the constraints whose gradients change as much as they are long within a step from most positions.

    Errors of this size leave nothing of the direction that the constraint forbids. A keypoint at a fixed distance r
    from a point, Φ = |x − p|², has |∇Φ| = 2r and |D²Φ| = 2, so that its constraint turns within steps longer than r.

    Args:
        phi: Φ.
        x: positions, image-plane units.
        step: image-plane units.
    """
    slopes, bends = (np.asarray(each, float) for each in _derivatives(phi, x))
    length, bends = np.linalg.norm(slopes, axis=-1), np.linalg.norm(bends, ord=2, axis=(-2, -1))
    return np.flatnonzero(np.mean(step * bends > length, axis=0) > 0.5).tolist()


def variation(phi: AbstractConstraint, x: Float[Array, "N T dim"]) -> Float[np.ndarray, "n"]:
    """Return by which share of itself a distance that each constraint keeps constant varies; 0 for straight lines.

    For each of N recordings the root of the mean over T frames of ((Φ − mean Φ) |D²Φ| / |DΦ|²)², and of these the
    median. For Φ = |x − p|² and for Φ = |x − p| alike this is the deviation of r = |x − p| divided by r.

    Args:
        phi: Φ, n values.
        x: positions, image-plane units.
    """
    flat = x.reshape(-1, x.shape[-1])
    values = np.asarray(jax.vmap(phi)(flat), float).reshape(*x.shape[:2], -1)
    slopes, bends = (np.asarray(each, float) for each in _derivatives(phi, flat))
    bent = np.linalg.norm(bends, ord=2, axis=(-2, -1)) / np.maximum(np.sum(slopes**2, axis=-1), 1e-12)
    shares = (values - values.mean(axis=1, keepdims=True)) * bent.reshape(values.shape)
    return np.median(np.sqrt(np.mean(shares**2, axis=1)), axis=0)


@eqx.filter_jit
def _derivatives(phi: AbstractConstraint, x: Array) -> tuple[Array, Array]:
    """Return DΦ `[M, n, dim]` and D²Φ `[M, n, dim, dim]`."""
    return jax.vmap(jax.jacfwd(phi))(x), jax.vmap(jax.hessian(phi))(x)


def _bent(slopes: np.ndarray, bends: np.ndarray) -> bool:
    left, values, right = np.linalg.svd(slopes)
    rank = int(np.sum(values > _ZERO))
    free = right[rank:]
    along = np.einsum("ik,iab,ma,nb->kmn", left[:, rank:], bends, free, free)
    return along.size > 0 and float(np.abs(along).max()) > _BENT * float(np.abs(bends).max())
