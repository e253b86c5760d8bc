"""Lagrangian mechanics in generalised coordinates (paper, eqs. 2–5 and 7)."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld._errors import KeycldError
from keycld.mechanics.lagrangian import AbstractLagrangian, ConstrainedLagrangian
from keycld.mechanics.linear import gram, solve_positive, times
from keycld.mechanics.networks import Perceptron


class GeneralizedLagrangian(AbstractLagrangian):
    """L(q, q̇) = ½ q̇ᵀM(q)q̇ − V(q) with M = L Lᵀ, and the external force g(q) u (eqs. 2–5).

    The Euler–Lagrange equations (4) give

        M q̈ = g u − ∇V − Ṁ q̇ + ∇_q(½ q̇ᵀM q̇).

    Args:
        factor: L, a callable q [m] → [m, r]: lower triangular (`MLPFactor`), or any other factor of M.
        potential: V, a callable q → number.
        input_matrix: g, a callable q → [m, l]; None where there is no input.
        solve: (M, f) → M⁻¹f. By default `solve_positive`, written out for a few coordinates; `solve_definite` is for
            more than about eight.
    """

    factor: Callable
    potential: Callable
    input_matrix: Callable | None = None
    solve: Callable = eqx.field(static=True, default=solve_positive)

    def mass_matrix(self, x: Float[Array, "m"]) -> Float[Array, "m m"]:
        """Return M(q) = L(q) L(q)ᵀ."""
        factor = self.factor(x)
        return gram(factor, factor)

    def kinetic_energy(self, x: Float[Array, "m"], v: Float[Array, "m"]) -> Float[Array, ""]:
        """Return T = ½ |Lᵀq̇|², eq. (3)."""
        return 0.5 * jnp.sum(times(self.factor(x).T, v) ** 2)

    def potential_energy(self, x: Float[Array, "m"]) -> Float[Array, ""]:
        """Return V(q)."""
        return self.potential(x)

    def acceleration(
        self,
        x: Float[Array, "m"],
        v: Float[Array, "m"],
        u: Float[Array, "l"],
        parameters: dict[str, Any] | None = None,
    ) -> Float[Array, "m"]:
        """Return q̈ from eq. (4); `parameters` are not used."""
        matrix, matrix_rate = jax.jvp(self.mass_matrix, (x,), (v,))
        force = jax.grad(lambda q: self.kinetic_energy(q, v) - self.potential(q))(x) - times(matrix_rate, v)
        if self.input_matrix is not None:
            force = force + times(self.input_matrix(x), u)
        return self.solve(matrix, force)


class MLPFactor(eqx.Module):
    """A lower triangular L(q) [m, m] by a perceptron, near the identity before training; M = L Lᵀ is never negative."""

    perceptron: Perceptron
    dim: int = eqx.field(static=True)

    def __init__(self, dim: int, width: int = 32, *, key: PRNGKeyArray):
        self.perceptron = Perceptron((dim, width, width, dim * dim), key)
        self.dim = dim

    def __call__(self, q: Float[Array, "m"]) -> Float[Array, "m m"]:
        """Return L(q)."""
        return jnp.eye(self.dim, dtype=q.dtype) + jnp.tril(self.perceptron(q).reshape(self.dim, self.dim))


def pulled_back(law: ConstrainedLagrangian, mapping: Callable) -> GeneralizedLagrangian:
    """Return the same mechanics in generalised coordinates, through the kinematic chain x = F(q), eq. (7).

    L(q, q̇) = ½ q̇ᵀ DFᵀM DF q̇ − V(F(q)), and the input matrix DFᵀg(F(q)). F maps into the constraint set, so
    the constraints of `law` hold by themselves and are not used.

    Args:
        law: point masses, potential and input matrix in Cartesian coordinates.
        mapping: F, a callable q [m] → x [2K].

    Raises:
        KeycldError: for a law with damping.
    """
    if law.dissipative:
        raise KeycldError("a law with damping has no Lagrangian to pull back: leave the damping out.")
    return GeneralizedLagrangian(
        eqx.Partial(_factor, law, mapping),
        eqx.Partial(_potential, law, mapping),
        None if law.input_matrix is None else eqx.Partial(_input_matrix, law, mapping),
    )


def _factor(law: ConstrainedLagrangian, mapping: Callable, q: Float[Array, "m"]) -> Float[Array, "m dim"]:
    # M = C Cᵀ, so DFᵀM DF is the square of DFᵀC.
    factor = jnp.linalg.cholesky(law.mass.matrix)
    return jnp.matmul(jax.jacfwd(mapping)(q).T, jnp.kron(factor, jnp.eye(2)), precision="highest")


def _potential(law: ConstrainedLagrangian, mapping: Callable, q: Float[Array, "m"]) -> Float[Array, ""]:
    return law.potential(mapping(q))


def _input_matrix(law: ConstrainedLagrangian, mapping: Callable, q: Float[Array, "m"]) -> Float[Array, "m l"]:
    assert law.input_matrix is not None
    return gram(jax.jacfwd(mapping)(q).T, law.input_matrix(mapping(q)).T)
