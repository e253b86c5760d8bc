"""Explicit Runge–Kutta methods for any equation of first order, each given by its coefficients."""

from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array, Float, PyTree

from keycld._errors import KeycldError
from keycld.mechanics.integrators import AbstractIntegrator, Parameters
from keycld.mechanics.state import AbstractField, Scalar


class RungeKutta(AbstractIntegrator):
    """An explicit Runge–Kutta method (Butcher's tableau) for ds/dt = F(s, u).

    kᵢ = F(s + h Σⱼ aᵢⱼ kⱼ, u) for j < i,   s' = s + h Σᵢ bᵢ kᵢ.

    Follows every `AbstractField`: Hamiltonians, laws of second order, learned fields. Not symplectic: energy drifts.
    `integrator_named` gives the usual ones. `Euler`, `RK2` and `RK4` are three of them written out for laws of second
    order.

    Attributes:
        rows: aᵢⱼ, one row a stage, of which the first is empty.
        weights: bᵢ, of sum 1.
        substeps: steps a frame.
    """

    rows: tuple[tuple[float, ...], ...] = eqx.field(static=True)
    weights: tuple[float, ...] = eqx.field(static=True)
    substeps: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        """Refuse coefficients that are no explicit method."""
        lengths = [len(row) for row in self.rows]
        if lengths != list(range(len(self.weights))) or abs(sum(self.weights) - 1) > 1e-9:
            raise KeycldError(
                "row i of an explicit Runge–Kutta method has i − 1 coefficients and its weights have sum 1, but the "
                f"rows have lengths {lengths} and the weights are {self.weights}: correct the coefficients."
            )

    def initial_memory(self, field: AbstractField, coordinates: PyTree, parameters: Parameters, h: Scalar) -> None:
        """Return None: there is nothing to remember."""

    def advance(
        self,
        field: AbstractField,
        coordinates: PyTree,
        memory: None,
        parameters: Parameters,
        u: Float[Array, "l"],
        h: Scalar,
    ) -> tuple[PyTree, None]:
        """Take one step."""
        rates: list[PyTree] = []
        for row in self.rows:
            rates.append(field.derivative(_along(coordinates, h, row, rates), u, parameters))
        return _along(coordinates, h, self.weights, rates), None


def _along(coordinates: PyTree, h: Scalar, weights: tuple[float, ...], rates: list[PyTree]) -> PyTree:
    """Return s + h Σ wᵢ kᵢ, without the terms of weight zero."""
    used = [(weight, rate) for weight, rate in zip(weights, rates, strict=True) if weight]
    if not used:
        return coordinates
    shares = [weight for weight, _ in used]

    def leaf(s: Array, *k: Array) -> Any:
        return s + h * sum(share * rate for share, rate in zip(shares, k, strict=True))

    return jax.tree.map(leaf, coordinates, *(rate for _, rate in used))
