"""A first guess of a law: its equation of motion, fitted to velocities and accelerations from differences."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree

from keycld.mechanics.force import SumPotential
from keycld.mechanics.lagrangian import ConstrainedLagrangian
from keycld.mechanics.masses import AbstractMassMatrix
from keycld.mechanics.state import Scalar

_WINDOW = 7
"""Frames of a local cubic."""
_LIGHTEST = 0.02
"""Least eigenvalue of a mass matrix, as a share of the mean one."""


def regress_forces(
    law: ConstrainedLagrangian,
    free: PyTree,
    observed: Float[Array, "N T dim"],
    u: Float[Array, "N *T l"],
    dt: Scalar,
) -> ConstrainedLagrangian:
    """Find masses and parameters of the forces with which the equation of motion holds best at the observed frames.

        min over m, θ of Σ |P ((m ⊗ I₂) ẍ − f(x, ẋ, u; θ))|²,    tr m = K,    P the projection on ker DΦ(x)

    is linear least squares where f is linear in θ. P removes the unknown constraint forces. ẋ and ẍ are those of a
    cubic through seven frames. Errors of ẍ make the result rough: it is a start for `fit_motions`. Terms with
    parameters that f is not linear in are tried in all their variants (`AbstractTerm.candidates`), one term at a time.

    Args:
        law: all free parameters of its forces are zero, or f does not depend on them because others are.
        free: a pytree of bools of the law's shape: which leaves are θ. Masses are always found.
        observed: observed positions at consecutive frames, image-plane units.
        u: inputs, constant or held per frame.
        dt: seconds between frames.
    """
    window = min(_WINDOW, observed.shape[1])
    states = _local_cubics(observed, float(dt), window)
    inputs = u[:, None] if u.ndim == 2 else u[:, window // 2 :][:, : states[0].shape[1]]
    inputs = jnp.broadcast_to(inputs, (*states[0].shape[:2], inputs.shape[-1]))
    rows = inputs.shape[0] * inputs.shape[1]
    x, v, a, inputs = (jnp.asarray(part).reshape(rows, part.shape[-1]) for part in (*states, inputs))
    project = jax.jit(jax.vmap(lambda x: _projection(law.jacobian(x))))(x)
    basis = _mass_basis(law.mass)
    mass = -np.einsum("rij,krj->rik", project, np.stack([_times(m, np.asarray(a)) for m in basis]))
    best: tuple[float, Any] = (np.inf, law)
    for variant in _variants(law):
        forces, unravel = _force_columns(variant, free, x, v, inputs)
        columns = np.concatenate([mass[:, :, 1:], np.einsum("rij,rjp->rip", project, forces)], axis=2)
        size = columns.shape[2]
        solution, misfit = _robust_least_squares(columns.reshape(-1, size), -mass[:, :, 0].reshape(-1))
        if misfit < best[0]:
            weights = np.concatenate([[1.0], solution[: len(basis) - 1]])
            matrix = np.tensordot(weights, basis, axes=1)
            found = eqx.tree_at(lambda law: law.mass, variant, law.mass.nearest(_positive(matrix)))
            best = misfit, eqx.combine(unravel(solution[len(basis) - 1 :]), found)
    return best[1]


def _local_cubics(observed: Array, dt: float, window: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions, velocities and accelerations `[N, T − window + 1, dim]` at the middle of each window."""
    offsets = dt * (np.arange(window) - window // 2)
    coefficients = np.linalg.pinv(np.vander(offsets, min(4, window), increasing=True))
    windows = np.lib.stride_tricks.sliding_window_view(np.asarray(observed, float), window, axis=1)
    x, v, a = (windows @ row for row in coefficients[:3])
    return x, v, 2 * a


def _projection(jacobian: Array) -> Array:
    """Return the projection on ker DΦ in the Euclidean metric, redundant constraints included."""
    dim = jacobian.shape[1]
    if not jacobian.size:
        return jnp.eye(dim)
    return jnp.eye(dim) - jnp.matmul(jnp.linalg.pinv(jacobian, rtol=1e-4), jacobian, precision="highest")


def _mass_basis(mass: AbstractMassMatrix) -> np.ndarray:
    """Return the identity and a basis of the other symmetric matrices `[n, K, K]` that the mass matrix can have."""
    count = mass.inverse.shape[0]
    unit = np.eye(count)
    diagonal = [np.diag(unit[k] - unit[k - 1]) for k in range(1, count)]
    coupled = [np.outer(unit[i], unit[j]) + np.outer(unit[j], unit[i]) for i in range(count) for j in range(i)]
    return np.stack([unit, *diagonal, *(coupled if mass.coupled else [])])


def _times(matrix: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.einsum("ij,rjc->ric", matrix, vectors.reshape(len(vectors), -1, 2)).reshape(vectors.shape)


def _variants(law: ConstrainedLagrangian) -> list[ConstrainedLagrangian]:
    """Return the law with each variant of each term that has several."""
    laws = [law]
    if isinstance(law.potential, SumPotential):
        for kind, term in law.potential.terms.items():
            others = term.candidates()[1:]
            laws += [eqx.tree_at(lambda law, kind=kind: law.potential.terms[kind], law, other) for other in others]
    return laws


def _force_columns(law: ConstrainedLagrangian, free: PyTree, x: Array, v: Array, u: Array) -> tuple[np.ndarray, Any]:
    """Return ∂f/∂θ `[rows, dim, P]` and the function from θ to a pytree of the law's free leaves."""
    forces = eqx.tree_at(_no_forces, free, replace=jax.tree.map(lambda _: False, _no_forces(free)))
    parameters, rest = eqx.partition(law, forces)
    flat, unravel = ravel_pytree(parameters)
    return np.asarray(_slopes(flat, unravel, rest, x, v, u), float), lambda theta: unravel(
        jnp.asarray(theta, flat.dtype)
    )


def _no_forces(law: Any) -> tuple[Any, Any]:
    return law.mass, law.constraint_function


@eqx.filter_jit
def _slopes(flat: Array, unravel: Any, rest: Any, x: Array, v: Array, u: Array) -> Array:
    def force(theta: Array, x: Array, v: Array, u: Array) -> Array:
        law = eqx.combine(unravel(theta), rest)
        return law.force(x, u) + law.friction(x, v)

    return jax.vmap(jax.jacrev(force), (None, 0, 0, 0))(flat, x, v, u)


def _robust_least_squares(columns: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the solution by reweighted least squares with Huber-like weights, and its mean absolute misfit."""
    scale = np.sqrt(np.mean(columns**2, axis=0))
    # A small ridge: terms that act alike share what they explain.
    live = scale > 1e-6 * max(float(scale.max(initial=0.0)), 1e-12)
    columns = np.where(live, columns / np.where(live, scale, 1.0), 0.0)
    weight = np.ones(len(target))
    solution = np.zeros(columns.shape[1])
    for _ in range(4):
        normal = (columns * weight[:, None]).T @ columns / len(target) + 1e-4 * np.eye(len(scale))
        solution = np.linalg.solve(normal, (columns * weight[:, None]).T @ target / len(target))
        error = np.abs(target - columns @ solution)
        weight = 1 / np.maximum(1.0, error / (2 * np.median(error) + 1e-12))
    return np.where(live, solution / np.where(live, scale, 1.0), 0.0), float(np.mean(error))


def _positive(matrix: np.ndarray) -> np.ndarray:
    """Return the nearest symmetric matrix whose eigenvalues are not too small."""
    values, vectors = np.linalg.eigh(matrix)
    return (vectors * np.maximum(values, _LIGHTEST * np.trace(matrix) / len(matrix))) @ vectors.T
