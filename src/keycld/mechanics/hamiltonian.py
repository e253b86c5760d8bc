"""Hamiltonian mechanics and the Legendre map to it from a Lagrangian, and back (paper, end of section 2)."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.mechanics.generalized import GeneralizedLagrangian
from keycld.mechanics.lagrangian import AbstractLagrangian
from keycld.mechanics.linear import solve_positive, times


class Hamiltonian(eqx.Module):
    """An energy H(q, p) with q̇ = ∂H/∂p, ṗ = −∂H/∂q + g(q) u.

    Args:
        function: H, a callable (q [m], p [m]) → number, smooth.
        input_matrix: g, a callable q → [m, l]; None where there is no input.
    """

    function: Callable
    input_matrix: Callable | None = None

    def energy(self, q: Float[Array, "m"], p: Float[Array, "m"]) -> Float[Array, ""]:
        """H(q, p)."""
        return self.function(q, p)

    def derivative(
        self, q: Float[Array, "m"], p: Float[Array, "m"], u: Float[Array, "l"]
    ) -> tuple[Float[Array, "m"], Float[Array, "m"]]:
        """(q̇, ṗ)."""
        by_q, by_p = jax.grad(self.function, argnums=(0, 1))(q, p)
        push = 0.0 if self.input_matrix is None else times(self.input_matrix(q), u)
        return by_p, push - by_q


def momentum(law: AbstractLagrangian, q: Float[Array, "m"], v: Float[Array, "m"]) -> Float[Array, "m"]:
    """Generalised momentum p = ∂L/∂q̇ = M(q) q̇."""
    return jax.grad(law.kinetic_energy, argnums=1)(q, v)


def to_hamiltonian(law: GeneralizedLagrangian) -> Hamiltonian:
    """The Legendre transform H = pᵀq̇ − L = ½ pᵀM(q)⁻¹p + V(q), p = M(q) q̇."""
    return Hamiltonian(eqx.Partial(_energy, law), law.input_matrix)


def _energy(law: GeneralizedLagrangian, q: Float[Array, "m"], p: Float[Array, "m"]) -> Float[Array, ""]:
    return 0.5 * jnp.sum(p * solve_positive(law.mass_matrix(q), p)) + law.potential(q)


class LegendreLaw(AbstractLagrangian):
    """The Legendre transform back: the law in (q, q̇) of a Hamiltonian that is quadratic in p.

    q̇ = ∂H/∂p is linear in p, so p = (∂²H/∂p²)⁻¹(q̇ − ∂H/∂p(q, 0)), and the acceleration is the rate of ∂H/∂p
    along Hamilton's equations.

    Attributes:
        hamiltonian: H with positive ∂²H/∂p².
    """

    hamiltonian: Hamiltonian

    def momentum(self, x: Float[Array, "m"], v: Float[Array, "m"]) -> Float[Array, "m"]:
        """Momentum p at which ∂H/∂p = q̇."""

        def velocity(p):
            return jax.grad(self.hamiltonian.function, argnums=1)(x, p)

        rest = jnp.zeros_like(v)
        return solve_positive(jax.jacfwd(velocity)(rest), v - velocity(rest))

    def kinetic_energy(self, x: Float[Array, "m"], v: Float[Array, "m"]) -> Float[Array, ""]:
        """H(q, p) − H(q, 0)."""
        return self.hamiltonian.energy(x, self.momentum(x, v)) - self.potential_energy(x)

    def potential_energy(self, x: Float[Array, "m"]) -> Float[Array, ""]:
        """H(q, 0)."""
        return self.hamiltonian.energy(x, jnp.zeros_like(x))

    def acceleration(
        self,
        x: Float[Array, "m"],
        v: Float[Array, "m"],
        u: Float[Array, "l"],
        parameters: dict[str, Any] | None = None,
    ) -> Float[Array, "m"]:
        """q̈, the rate of ∂H/∂p; `parameters` play no part."""
        p = self.momentum(x, v)
        rates = self.hamiltonian.derivative(x, p, u)
        velocity = jax.grad(self.hamiltonian.function, argnums=1)
        return jax.jvp(velocity, (x, p), rates)[1]
