"""Explicit symplectic integrators of separable Hamiltonians, each given by its coefficients."""

from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics.hamiltonian import SeparableHamiltonian
from keycld.mechanics.integrators import AbstractIntegrator, Parameters
from keycld.mechanics.lagrangian import combine
from keycld.mechanics.state import AbstractField, PhasePoint, Scalar


class Composition(AbstractIntegrator):
    """Kicks and drifts in turn, for H = T(p) + V(q).

    kick: p ← p + b h (−∇V(q) + g(q) u),   drift: q ← q + a h ∇T(p).

    Symplectic: the error of the energy stays bounded. If kicks and drifts are the same read from either end, the
    method is reversible: the step with −h undoes the step with h. `integrator_named` gives the usual ones.

    Attributes:
        kicks: shares b of the step, of sum 1.
        drifts: shares a of the step, of sum 1; as many as kicks, or one more or less.
        kick_first: whether a step begins with a kick.
        substeps: steps a frame.
    """

    kicks: tuple[float, ...] = eqx.field(static=True)
    drifts: tuple[float, ...] = eqx.field(static=True)
    kick_first: bool = eqx.field(static=True)
    substeps: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        """Refuse shares that do not alternate or do not make up a whole step."""
        first, second = (self.kicks, self.drifts) if self.kick_first else (self.drifts, self.kicks)
        whole = all(abs(sum(shares) - 1) < 1e-9 for shares in (first, second))
        if len(first) - len(second) not in (0, 1) or not whole:
            raise KeycldError(
                "a composition alternates between kicks and drifts, each of sum 1, "
                f"but it has kicks {self.kicks} and drifts {self.drifts}: correct the coefficients."
            )

    def initial_memory(self, field: AbstractField, coordinates: PhasePoint, parameters: Parameters, h: Scalar) -> Any:
        """Return ∇V and g at q, or ∇T at p: what the first kick or drift uses.

        Raises:
            KeycldError: for a Hamiltonian that is not separable, or anything else.
        """
        if not isinstance(field, SeparableHamiltonian):
            raise KeycldError(
                f"explicit symplectic steps need a SeparableHamiltonian H = T(p) + V(q), not a {type(field).__name__}: "
                "use a Runge–Kutta method such as rk4."
            )
        return self._known(field, coordinates, self.kick_first)

    def advance(
        self,
        field: SeparableHamiltonian,
        coordinates: PhasePoint,
        memory: Any,
        parameters: Parameters,
        u: Float[Array, "l"],
        h: Scalar,
    ) -> tuple[PhasePoint, Any]:
        """Take one step."""
        point, known, kick = coordinates, memory, self.kick_first
        kicks, drifts = iter(self.kicks), iter(self.drifts)
        for stage in range(len(self.kicks) + len(self.drifts)):
            if stage:
                kick = not kick
                known = self._known(field, point, kick)
            if kick:
                point = PhasePoint(point.q, point.p + next(kicks) * h * combine(known, u))
            else:
                point = PhasePoint(point.q + next(drifts) * h * known, point.p)
        # A kick does not change q, nor a drift p: after a last stage like the first, what is known still holds.
        return point, known if kick == self.kick_first else self._known(field, point, self.kick_first)

    def _known(self, field: SeparableHamiltonian, point: PhasePoint, kick: bool) -> Any:
        return field.fields(point.q) if kick else field.velocity(point.p)
