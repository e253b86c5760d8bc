"""Energy shaping: the potential energy that the system feels is replaced by one with its minimum at the goal."""

import abc
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.control.base import AbstractController, Belief, spread
from keycld.mechanics import ConstrainedLagrangian, solve_positive

_SINGULAR = 0.05
"""Of the usual inverse inertia: below it an input counts as without effect."""


class Energies(NamedTuple):
    """Energies of a motion in the model's own unit: kinetic, potential, desired potential, input power."""

    kinetic: Float[Array, "..."]
    potential: Float[Array, "..."]
    desired: Float[Array, "..."]
    power: Float[Array, "..."]


class AbstractShaping(AbstractController):
    """Replaces V by a bowl around the goal, and damps.

    Attributes:
        law: masses, potential energy, input matrix, constraints.
        goal: x* [2K], image-plane units.
        actuators: numbers of the inputs that act; the others stay zero.
        kp: stiffness.
        kd: damping.
    """

    law: eqx.AbstractVar[ConstrainedLagrangian]
    goal: eqx.AbstractVar[Float[Array, "dim"]]
    actuators: eqx.AbstractVar[tuple[int, ...]]
    kp: eqx.AbstractVar[float]
    kd: eqx.AbstractVar[float]

    @abc.abstractmethod
    def desired_energy(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """V_d(x), in the model's unit of energy."""

    def begin(self) -> None:
        """Nothing to remember."""

    def energies(self, x: Float[Array, "dim"], v: Float[Array, "dim"], u: Float[Array, "l"]) -> Energies:
        """T, V, V_d and the power uᵀgᵀv of one motion; the loop is passive where T + V_d never rises."""
        power = jnp.sum(u * _matmul(input_matrix(self.law, x).T, v))
        return Energies(self.law.kinetic_energy(x, v), self.law.potential_energy(x), self.desired_energy(x), power)


class EnergyShaping(AbstractShaping):
    """The paper's controller without what training leaves open (section 4 and A.5; see `docs/control.md`).

    V_d = ½ kp (x − x*)ᵀ M (x − x*). The forces that turn V into V_d are g u + DΦᵀλ = ∇V − ∇V_d, as far as the inputs
    can: least squares in the metric M⁻¹, in which the miss is an acceleration. Eliminating λ, which does no work,

        G u = gᵀ [P (∇V − M b − ∇V_d) − kd v],   G = gᵀ P g,   P = M⁻¹ − M⁻¹DΦᵀ(DΦ M⁻¹ DΦᵀ)⁻¹DΦ M⁻¹,

    where b is what the observer finds the learned accelerations to lack. P f is the acceleration that a force f causes,
    so P DΦᵀ = 0: adding DΦᵀα(x) to g or ∇V changes nothing, nor does a common factor of (M, V, g). With as many inputs
    as degrees of freedom the motion is that of a ball in a bowl, a = P(−∇V_d) − kd v + curvature, and T + V_d falls by
    kd·2T.

    A learned g may vanish where training never was. G u = r is therefore solved as robots do near a singular pose
    (Nakamura and Hanafusa 1986), by damped least squares, (G G*⁻¹ G + ε² G*) u = G G*⁻¹ r with G* the G of the goal and
    ε = 0.05: nothing changes where G is like G*, and no input is more than 1/2ε times what it would be there.

    Attributes: of `AbstractShaping`; kp and kd by mass, 1/s² and 1/s: small deviations swing with √kp rad/s.

    Good values: kp = 5, kd = 2 for every system (a damping ratio of 0.45).
    """

    law: ConstrainedLagrangian
    goal: Float[Array, "dim"]
    actuators: tuple[int, ...] = eqx.field(static=True)
    kp: float = 5.0
    kd: float = 2.0

    def act(self, belief: Belief, memory: None) -> tuple[Float[Array, "l"], None]:
        """The input, [l]."""
        x, v = belief.state.coordinates
        parameters = belief.state.parameters
        gradient, _ = self.law.fields(x)
        wanted = gradient - self.law.times_mass(belief.unmodelled + self.kp * (x - self.goal))
        columns, pushed = self._pushes(x, parameters)
        moving = self.law.project_velocity(x, v, parameters)
        right = _matmul(pushed.T, wanted) - self.kd * _matmul(columns.T, moving)
        here = _matmul(columns.T, pushed)
        columns, pushed = self._pushes(self.goal, parameters)
        usual = _matmul(columns.T, pushed)
        weighed = _matmul(here, jnp.linalg.inv(usual))
        u = solve_positive(_matmul(weighed, here) + _SINGULAR**2 * usual, _matmul(weighed, right))
        return spread(u, self.actuators, len(input_matrix(self.law, x).T)), None

    def desired_energy(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """½ kp (x − x*)ᵀ M (x − x*)."""
        return self.kp * self.law.kinetic_energy(x, x - self.goal)

    def _pushes(self, x: Array, parameters: dict[str, Array]) -> tuple[Array, Array]:
        """The acting columns of g and of P g."""
        columns = input_matrix(self.law, x)[:, jnp.asarray(self.actuators)]
        free = self.law.over_mass(columns.T)
        return columns, jax.vmap(lambda a: self.law.project_velocity(x, a, parameters), out_axes=1)(free)


class PaperLaw(AbstractShaping):
    """Eq. (15) to the letter: u = (gᵀg)⁻¹gᵀ[∇V − kp (x − x*)] − kd gᵀv.

    It depends on the arbitrary scale of (M, V, g), acting like gains kp/c and kd·c, and on parts of g and ∇V along
    DΦᵀ that training never determines; it may fail with perfect physics.

    Attributes: of `AbstractShaping`.
    """

    law: ConstrainedLagrangian
    goal: Float[Array, "dim"]
    actuators: tuple[int, ...] = eqx.field(static=True)
    kp: float = 5.0
    kd: float = 2.0

    def act(self, belief: Belief, memory: None) -> tuple[Float[Array, "l"], None]:
        """The input, [l]."""
        x, v = belief.state.coordinates
        matrix = input_matrix(self.law, x)
        columns = matrix[:, jnp.asarray(self.actuators)]
        gradient, _ = self.law.fields(x)
        wanted = _matmul(columns.T, gradient - self.kp * (x - self.goal))
        u = solve_positive(_matmul(columns.T, columns), wanted) - self.kd * _matmul(columns.T, v)
        return spread(u, self.actuators, matrix.shape[1]), None

    def desired_energy(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """½ kp |x − x*|², the one whose gradient eq. (15) uses."""
        return 0.5 * self.kp * jnp.sum((x - self.goal) ** 2)


def input_matrix(law: ConstrainedLagrangian, x: Float[Array, "dim"]) -> Float[Array, "dim l"]:
    """g(x) of a law that has inputs, as `lagrangian_of` makes sure."""
    assert law.input_matrix is not None
    return law.input_matrix(x)


def _matmul(a: Array, b: Array) -> Array:
    return jnp.matmul(a, b, precision="highest")
