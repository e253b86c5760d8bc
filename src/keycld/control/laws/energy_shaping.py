"""Energy shaping, independent of what training leaves open."""

from dataclasses import dataclass
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.control.base import Belief, spread
from keycld.control.registry import AbstractControlLaw, Problem, check_positive, register_law
from keycld.control.shaping import AbstractShaping, input_matrix
from keycld.mechanics import ConstrainedLagrangian, matmul, solve_positive

_SINGULAR = 0.05
"""ε: an input whose effect G is below this share of its effect at the goal counts as without effect."""


class EnergyShaping(AbstractShaping):
    """Energy shaping (paper, section 4 and A.5) that depends on nothing that training leaves open.

    The desired potential energy is V_d = ½ kp (x − x*)ᵀ M (x − x*). The forces that turn V into V_d satisfy
    g u + DΦᵀλ = ∇V − ∇V_d as far as the inputs can: in the sense of least squares in the metric M⁻¹, where the residual
    is an acceleration. Eliminating λ, which does no work, gives

        G u = gᵀ [P (∇V − M b − ∇V_d) − kd v],   G = gᵀ P g,   P = M⁻¹ − M⁻¹DΦᵀ(DΦ M⁻¹ DΦᵀ)⁻¹DΦ M⁻¹,

    where b is the acceleration that the state estimator finds the learned dynamics to lack. P f is the acceleration
    that a force f causes, so P DΦᵀ = 0: adding DΦᵀα(x) to g or ∇V changes nothing, and neither does a common factor of
    (M, V, g). With as many inputs as degrees of freedom the motion is that of a ball in a bowl,
    a = P(−∇V_d) − kd v + curvature, and T + V_d falls at the rate 2 kd T.

    A learned g may vanish in regions without training data. G u = r is therefore solved by damped least squares, as is
    usual for robots near a singular pose (Nakamura and Hanafusa 1986): (G G*⁻¹ G + ε² G*) u = G G*⁻¹ r, with G* the G
    of the goal and ε = 0.05. Nothing changes where G is like G*, and no input exceeds 1/(2ε) = 10 times its value
    there.

    Attributes:
        law: masses, potential energy, input matrix, constraints.
        goal: x* [2K], image-plane units.
        actuators: positions of the inputs that act; the others stay zero.
        kp: stiffness by mass, 1/s²; small deviations oscillate at √kp rad/s.
        kd: damping by mass, 1/s.

    Good values: kp = 5, kd = 2 for every system (a damping ratio of 0.45).
    """

    law: ConstrainedLagrangian
    goal: Float[Array, "dim"]
    actuators: tuple[int, ...] = eqx.field(static=True)
    kp: float = 5.0
    kd: float = 2.0

    def act(self, belief: Belief, memory: None) -> tuple[Float[Array, "l"], None]:
        """Return the input, [l]."""
        x, v = belief.state.coordinates
        parameters = belief.state.parameters
        gradient, _ = self.law.fields(x)
        wanted = gradient - self.law.times_mass(belief.unmodelled + self.kp * (x - self.goal))
        columns, pushed = self._pushes(x, parameters)
        moving = self.law.project_velocity(x, v, parameters)
        right = matmul(pushed.T, wanted) - self.kd * matmul(columns.T, moving)
        here = matmul(columns.T, pushed)
        columns, pushed = self._pushes(self.goal, parameters)
        usual = matmul(columns.T, pushed)
        weighed = matmul(here, jnp.linalg.inv(usual))
        u = solve_positive(matmul(weighed, here) + _SINGULAR**2 * usual, matmul(weighed, right))
        return spread(u, self.actuators, len(input_matrix(self.law, x).T)), None

    def desired_energy(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return ½ kp (x − x*)ᵀ M (x − x*)."""
        return self.kp * self.law.kinetic_energy(x, x - self.goal)

    def _pushes(self, x: Array, parameters: dict[str, Array]) -> tuple[Array, Array]:
        """Return the acting columns of g and of P g."""
        columns = input_matrix(self.law, x)[:, jnp.asarray(self.actuators)]
        free = self.law.over_mass(columns.T)
        return columns, jax.vmap(lambda a: self.law.project_velocity(x, a, parameters), out_axes=1)(free)


@register_law
@dataclass(frozen=True)
class ShapingLaw(AbstractControlLaw):
    """Energy shaping: the inputs replace the potential energy by a bowl around the goal.

    Attributes:
        kp: stiffness by mass, 1/s²; small deviations oscillate at √kp rad/s.
        kd: damping by mass, 1/s.
    """

    name: ClassVar[str] = "shaping"
    kp: float = 5.0
    kd: float = 2.0

    def __post_init__(self):
        """Check that both gains are positive."""
        check_positive(kp=self.kp, kd=self.kd)

    def controller(self, problem: Problem) -> EnergyShaping:
        """Return the controller for a problem."""
        return EnergyShaping(problem.law, problem.goal, problem.actuators, self.kp, self.kd)
