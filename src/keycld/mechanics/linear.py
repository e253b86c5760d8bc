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
    """Elimination without row exchanges: unit lower part, upper part, inverse pivots, and the ridge added."""

    lower: list[list[Array]]
    upper: list[list[Array]]
    inverse_pivots: list[Array]
    ridge: list[Array]


def factor(matrix: Float[Array, "n n"], near: Factors | None = None) -> Factors:
    """Factors of a symmetric positive semi-definite matrix, or of one near to such a matrix.

    A ridge of eps^(2/3) of its diagonal (2e-5 in float32) is added, so that redundant constraints share their
    multipliers and none of them grows without bound. A row of zeros gets the solution zero.

    Args:
        matrix: symmetric positive semi-definite; or, with `near`, a matrix not far from one.
        near: factors of the near positive matrix. Its ridge serves again, and pivots are kept above half of
            its pivots, which bounds a step of Newton's method.
    """
    n = matrix.shape[0]
    limits = jnp.finfo(matrix.dtype)
    upper = [[matrix[i, j] for j in range(n)] for i in range(n)]
    ridge = [float(limits.eps) ** (2 / 3) * upper[k][k] for k in range(n)] if near is None else near.ridge
    lower: list[list[Array]] = [[] for _ in range(n)]
    inverse_pivots: list[Array] = []
    for k in range(n):
        pivot = upper[k][k] + ridge[k]
        if near is None:
            sound = ridge[k] > float(limits.tiny) ** 0.5
            inverse = jnp.where(sound, 1 / jnp.where(sound, jnp.maximum(pivot, ridge[k] / 2), 1.0), 0.0)
        else:
            inverse = near.inverse_pivots[k] / jnp.maximum(pivot * near.inverse_pivots[k], 0.5)
        inverse_pivots.append(inverse)
        for i in range(k + 1, n):
            ratio = upper[i][k] * inverse
            lower[i].append(ratio)
            for j in range(k + 1, n):
                upper[i][j] = upper[i][j] - ratio * upper[k][j]
    return Factors(lower, upper, inverse_pivots, ridge)


def substitute(factors: Factors, b: Float[Array, "n"]) -> Float[Array, "n"]:
    """The solution of the factored system for one right-hand side."""
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

    Square-root-free (a + ridge = L diag(p) Lᵀ) and unrolled over n. Two steps of refinement take the ridge's
    effect away where `a` is sound; where it is singular but the system consistent, the solution is one of many,
    with a small z, and a matrix of zeros gives zeros. Derivatives of every order are those of the solution,
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
        z = z + substitute(factors, b - matvec(z))
        return z + substitute(factors, b - matvec(z))

    return jax.lax.custom_linear_solve(partial(times, a), b, solve, symmetric=True)


def times(matrix: Float[Array, "n m"], vector: Float[Array, "m"]) -> Float[Array, "n"]:
    """Product of a matrix and a vector as a sum: full float32 on every device, fused with its neighbours."""
    return jnp.sum(matrix * vector[None, :], axis=1)


def gram(left: Float[Array, "n m"], right: Float[Array, "k m"]) -> Float[Array, "n k"]:
    """Products of all rows, left · rightᵀ, as a sum of products."""
    return jnp.sum(left[:, None, :] * right[None, :, :], axis=2)
