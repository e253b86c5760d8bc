"""Hamiltonian mechanics, and the Legendre transform to it from a Lagrangian, and back (paper, end of section 2)."""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.mechanics.generalized import GeneralizedLagrangian
from keycld.mechanics.lagrangian import AbstractLagrangian, combine
from keycld.mechanics.linear import solve_positive, times
from keycld.mechanics.state import AbstractField, PhasePoint


class AbstractHamiltonian(AbstractField):
    """An energy H(q, p) with q̇ = ∂H/∂p, ṗ = −∂H/∂q + g(q) u.

    Attributes:
        input_matrix: g, a callable q [m] → [m, l]; None where there is no input.
    """

    input_matrix: eqx.AbstractVar[Callable | None]

    @abc.abstractmethod
    def energy(self, q: Float[Array, "m"], p: Float[Array, "m"]) -> Float[Array, ""]:
        """Return H(q, p)."""

    def derivative(
        self, coordinates: PhasePoint, u: Float[Array, "l"], parameters: dict[str, Any] | None = None
    ) -> PhasePoint:
        """Return (q̇, ṗ); `parameters` are not used."""
        q, p = coordinates
        by_q, by_p = jax.grad(self.energy, argnums=(0, 1))(q, p)
        push = 0.0 if self.input_matrix is None else times(self.input_matrix(q), u)
        return PhasePoint(by_p, push - by_q)


class Hamiltonian(AbstractHamiltonian):
    """Any Hamiltonian.

    Args:
        function: H, a callable (q [m], p [m]) → number, smooth.
        input_matrix: g, a callable q [m] → [m, l]; None where there is no input.
    """

    function: Callable
    input_matrix: Callable | None = None

    def energy(self, q: Float[Array, "m"], p: Float[Array, "m"]) -> Float[Array, ""]:
        """Return H(q, p)."""
        return self.function(q, p)


class SeparableHamiltonian(AbstractHamiltonian):
    """A Hamiltonian H = T(p) + V(q), which explicit symplectic integrators can follow.

    Args:
        kinetic: T, a callable p [m] → number, smooth.
        potential: V, a callable q [m] → number, smooth.
        input_matrix: g, a callable q [m] → [m, l]; None where there is no input.
    """

    kinetic: Callable
    potential: Callable
    input_matrix: Callable | None = None

    def energy(self, q: Float[Array, "m"], p: Float[Array, "m"]) -> Float[Array, ""]:
        """Return T(p) + V(q)."""
        return self.kinetic(p) + self.potential(q)

    def velocity(self, p: Float[Array, "m"]) -> Float[Array, "m"]:
        """Return q̇ = ∇T(p)."""
        return jax.grad(self.kinetic)(p)

    def fields(self, q: Float[Array, "m"]) -> tuple[Float[Array, "m"], Float[Array, "m l"] | None]:
        """Return ∇V(q) and g(q): what an integrator keeps of a position, whatever the input will be."""
        return jax.grad(self.potential)(q), None if self.input_matrix is None else self.input_matrix(q)

    def force(self, q: Float[Array, "m"], u: Float[Array, "l"]) -> Float[Array, "m"]:
        """Return ṗ = −∇V(q) + g(q) u."""
        return combine(self.fields(q), u)


def momentum(law: AbstractLagrangian, q: Float[Array, "m"], v: Float[Array, "m"]) -> Float[Array, "m"]:
    """Compute the generalised momentum p = ∂L/∂q̇ = M(q) q̇."""
    return jax.grad(law.kinetic_energy, argnums=1)(q, v)


def to_hamiltonian(law: GeneralizedLagrangian) -> Hamiltonian:
    """Return the Legendre transform H = pᵀq̇ − L = ½ pᵀM(q)⁻¹p + V(q), p = M(q) q̇."""
    return Hamiltonian(function=eqx.Partial(_energy, law), input_matrix=law.input_matrix)


def _energy(law: GeneralizedLagrangian, q: Float[Array, "m"], p: Float[Array, "m"]) -> Float[Array, ""]:
    return 0.5 * jnp.sum(p * law.solve(law.mass_matrix(q), p)) + law.potential(q)


class LegendreLaw(AbstractLagrangian):
    """The Legendre transform back: the law in (q, q̇) of a Hamiltonian that is quadratic in p.

    q̇ = ∂H/∂p is linear in p, so p = (∂²H/∂p²)⁻¹(q̇ − ∂H/∂p(q, 0)), and the acceleration is the rate of ∂H/∂p
    along Hamilton's equations.

    Attributes:
        hamiltonian: H with positive ∂²H/∂p².
    """

    hamiltonian: AbstractHamiltonian

    def momentum(self, x: Float[Array, "m"], v: Float[Array, "m"]) -> Float[Array, "m"]:
        """Return the momentum p at which ∂H/∂p = q̇."""

        def velocity(p):
            return jax.grad(self.hamiltonian.energy, argnums=1)(x, p)

        rest = jnp.zeros_like(v)
        return solve_positive(jax.jacfwd(velocity)(rest), v - velocity(rest))

    def kinetic_energy(self, x: Float[Array, "m"], v: Float[Array, "m"]) -> Float[Array, ""]:
        """Return H(q, p) − H(q, 0)."""
        return self.hamiltonian.energy(x, self.momentum(x, v)) - self.potential_energy(x)

    def potential_energy(self, x: Float[Array, "m"]) -> Float[Array, ""]:
        """Return H(q, 0)."""
        return self.hamiltonian.energy(x, jnp.zeros_like(x))

    def acceleration(
        self,
        x: Float[Array, "m"],
        v: Float[Array, "m"],
        u: Float[Array, "l"],
        parameters: dict[str, Any] | None = None,
    ) -> Float[Array, "m"]:
        """Return q̈, the rate of ∂H/∂p; `parameters` are not used."""
        p = self.momentum(x, v)
        rates = self.hamiltonian.derivative(PhasePoint(x, p), u)
        velocity = jax.grad(self.hamiltonian.energy, argnums=1)
        return jax.jvp(velocity, (x, p), (rates.q, rates.p))[1]
