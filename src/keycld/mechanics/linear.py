"""Small linear systems, solved without LAPACK.

A system of a few keypoints has one to five constraints, and its n × n matrices sit in the innermost loop of
training. Elimination unrolled over the static n is plain arithmetic on numbers, which XLA fuses and `vmap`
turns into arithmetic on vectors; a batched LAPACK call costs far more.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Factors(NamedTuple):
    """Elimination without row exchanges: unit lower part, upper part, damped inverses of the pivots."""

    lower: list[list[Array]]
    upper: list[list[Array]]
    inverse_pivots: list[Array]


def _damped_inverse(pivot: Array, scale: Array) -> Array:
    """Return 1/pivot, or nearly zero where rounding has lost the pivot compared with `scale`, the diagonal element.

    With r = pivot/scale it is r³/(r⁴ + ε⁴)/scale: 1/pivot for a sound pivot, zero for a lost one, smooth between.
    So a redundant constraint gets no multiplier instead of a random one.
    """
    epsilon = float(jnp.finfo(pivot.dtype).eps) ** (2 / 3)
    sound = scale > float(jnp.finfo(pivot.dtype).tiny) ** 0.5
    safe = jnp.where(sound, scale, 1.0)
    ratio = pivot / safe
    return jnp.where(sound, ratio**3 / (ratio**4 + epsilon**4) / safe, 0.0)


def factor(matrix: Float[Array, "n n"], reference: list[Array] | None = None) -> Factors:
    """Factorise a positive (semi-)definite matrix, or one near to such a matrix.

    Args:
        matrix: symmetric positive semi-definite, or, with `reference`, a matrix not far from one.
        reference: inverse pivots of the near positive matrix. Pivots are then kept above half of the
            reference ones, which bounds a Newton step far from the point of the reference.
    """
    n = matrix.shape[0]
    upper = [[matrix[i, j] for j in range(n)] for i in range(n)]
    lower: list[list[Array]] = [[] for _ in range(n)]
    inverse_pivots: list[Array] = []
    for k in range(n):
        pivot = upper[k][k]
        if reference is None:
            inverse = _damped_inverse(pivot, matrix[k, k])
        else:
            inverse = reference[k] / jnp.maximum(pivot * reference[k], 0.5)
        inverse_pivots.append(inverse)
        for i in range(k + 1, n):
            ratio = upper[i][k] * inverse
            lower[i].append(ratio)
            for j in range(k + 1, n):
                upper[i][j] = upper[i][j] - ratio * upper[k][j]
    return Factors(lower, upper, inverse_pivots)


def substitute(factors: Factors, b: Float[Array, "n"]) -> Float[Array, "n"]:
    """Solve the factored system for one right-hand side."""
    n = b.shape[0]
    if n == 0:
        return b
    forward: list[Array] = []
    for i in range(n):
        value = b[i]
        for k in range(i):
            value = value - factors.lower[i][k] * forward[k]
        forward.append(value)
    solution: list[Array] = [b[0]] * n
    for i in reversed(range(n)):
        value = forward[i]
        for j in range(i + 1, n):
            value = value - factors.upper[i][j] * solution[j]
        solution[i] = factors.inverse_pivots[i] * value
    return jnp.stack(solution)


def solve_positive(a: Float[Array, "n n"], b: Float[Array, "n"]) -> Float[Array, "n"]:
    """Solve a z = b for a small symmetric positive semi-definite `a` by a damped Cholesky factorisation.

    Square-root-free (a = L diag(p) Lᵀ) and unrolled over n, with one step of refinement. A pivot that
    rounding has swallowed counts as zero and its unknown becomes zero: a singular but consistent system gives
    one of its solutions, a zero matrix gives zeros. Derivatives of every order are those of the solution,
    dz = a⁻¹(db − da z); the elimination itself, whose derivative explodes at singular matrices, is never
    differentiated.

    Args:
        a: symmetric positive semi-definite matrix; n = 0 is allowed.
        b: right-hand side.

    Returns:
        The solution, finite for finite input.
    """
    factors = factor(jax.lax.stop_gradient(a))

    def solve(matvec, b):
        z = substitute(factors, b)
        return z + substitute(factors, b - matvec(z))

    return jax.lax.custom_linear_solve(partial(times, a), b, solve, symmetric=True)


def solve_definite(a: Float[Array, "n n"], b: Float[Array, "n"]) -> Float[Array, "n"]:
    """Solve a z = b by LAPACK's Cholesky factorisation; `a` is positive definite. For more than about eight unknowns.

    Args:
        a: symmetric, with no eigenvalue near zero; otherwise the solution is NaN.
        b: right-hand side.
    """
    return jax.scipy.linalg.solve(a, b, assume_a="pos")


def matmul(a: Array, b: Array) -> Array:
    """Return a·b in full float32 precision, which a GPU's matrix units do not have by default (TF32)."""
    return jnp.matmul(a, b, precision="highest")


def times(matrix: Float[Array, "n m"], vector: Float[Array, "m"]) -> Float[Array, "n"]:
    """Multiply a matrix and a vector as a sum: full float32 on every device, fused with its neighbours."""
    return jnp.sum(matrix * vector[None, :], axis=1)


def gram(left: Float[Array, "n m"], right: Float[Array, "k m"]) -> Float[Array, "n k"]:
    """Multiply all rows, left · rightᵀ, as a sum of products."""
    return jnp.sum(left[:, None, :] * right[None, :, :], axis=2)
