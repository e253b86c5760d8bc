"""Eq. (15) of the paper as printed, for comparison."""

from dataclasses import dataclass
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.control.base import Belief, spread
from keycld.control.registry import AbstractControlLaw, Problem, check_positive, register_law
from keycld.control.shaping import AbstractShaping, input_matrix
from keycld.mechanics import ConstrainedLagrangian, matmul, solve_positive


class PaperShaping(AbstractShaping):
    """Energy shaping as the paper prints it, eq. (15): u = (gᵀg)⁻¹gᵀ[∇V − kp (x − x*)] − kd gᵀv.

    It depends on the arbitrary common factor c of (M, V, g), as if the gains were kp/c and kd·c, and on the parts of g
    and ∇V along DΦᵀ, which training never determines. It may fail with perfect physics.

    Attributes:
        law: masses, potential energy, input matrix, constraints.
        goal: x* [2K], image-plane units.
        actuators: positions of the inputs that act; the others stay zero.
        kp: stiffness, the model's unit of energy by image-plane unit².
        kd: damping, input² by the unit of power of the model.

    Good values: none holds for every model; at a mean learned mass of 1, kp = 5 and kd = 2.
    """

    law: ConstrainedLagrangian
    goal: Float[Array, "dim"]
    actuators: tuple[int, ...] = eqx.field(static=True)
    kp: float = 5.0
    kd: float = 2.0

    def act(self, belief: Belief, memory: None) -> tuple[Float[Array, "l"], None]:
        """Return the input, [l]."""
        x, v = belief.state.coordinates
        matrix = input_matrix(self.law, x)
        columns = matrix[:, jnp.asarray(self.actuators)]
        gradient, _ = self.law.fields(x)
        wanted = matmul(columns.T, gradient - self.kp * (x - self.goal))
        u = solve_positive(matmul(columns.T, columns), wanted) - self.kd * matmul(columns.T, v)
        return spread(u, self.actuators, matrix.shape[1]), None

    def desired_energy(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return ½ kp |x − x*|², whose gradient eq. (15) uses."""
        return 0.5 * self.kp * jnp.sum((x - self.goal) ** 2)


@register_law
@dataclass(frozen=True)
class PaperLaw(AbstractControlLaw):
    """Energy shaping by the paper's eq. (15) as printed: depends on the arbitrary scale of the energies.

    Attributes:
        kp: stiffness, the model's unit of energy by image-plane unit².
        kd: damping, input² by the unit of power of the model.
    """

    name: ClassVar[str] = "paper"
    kp: float = 5.0
    kd: float = 2.0

    def __post_init__(self):
        """Check that both gains are positive."""
        check_positive(kp=self.kp, kd=self.kd)

    def controller(self, problem: Problem) -> PaperShaping:
        """Return the controller for a problem."""
        return PaperShaping(problem.law, problem.goal, problem.actuators, self.kp, self.kd)
