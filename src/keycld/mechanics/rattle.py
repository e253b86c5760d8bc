"""RATTLE: SHAKE with velocities that satisfy the constraints too, and with friction."""

from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics.integrators import AbstractIntegrator, Parameters
from keycld.mechanics.lagrangian import AbstractLaw, ConstrainedLagrangian, combine, tangential
from keycld.mechanics.shake import check_iterations, constrained_drift
from keycld.mechanics.state import Motion, Scalar


class Memory(NamedTuple):
    """What a sub-step knows of its first position."""

    fields: Any
    jacobian: Float[Array, "n dim"]


class Rattle(AbstractIntegrator):
    """RATTLE (Andersen 1983; Leimkuhler and Skeel 1994, the paper's [39]).

    v½ = v + h/2 M⁻¹f(x) + M⁻¹DΦ(x)ᵀλ,   x' = x + h v½ with Φ(x') = constants,
    v' = P(x')(v½ + h/2 M⁻¹f(x')),        P the projection on ker DΦ in the mass metric.

    Order 2, symplectic, reversible; without constraints exactly velocity Verlet. Φ stays at the constants of
    the state, so rounding cannot accumulate. Friction is split off symmetrically (Strang): half a step of
    v̇ = −P M⁻¹∂R/∂v before and after, by the mid-point rule.

    Attributes:
        substeps: steps a frame. A step of rotation θ shifts a frequency by about θ²/24.
        iterations: of Newton's method; 3 hold Φ to float32 for rotations up to 0.3 rad a sub-step.
    """

    substeps: int = eqx.field(static=True, default=1)
    iterations: int = eqx.field(static=True, default=3)

    def __check_init__(self):
        """Refuse less than one iteration."""
        check_iterations(self.iterations)

    def initial_memory(self, law: AbstractLaw, motion: Motion, parameters: Parameters, h: Scalar) -> Memory:
        """Return the fields and DΦ.

        Raises:
            KeycldError: for a law that is not a `ConstrainedLagrangian`.
        """
        if not isinstance(law, ConstrainedLagrangian):
            raise KeycldError(f"RATTLE integrates point masses, not a {type(law).__name__}: use RK4.")
        return Memory(law.fields(motion.x), law.jacobian(motion.x, parameters))

    def advance(
        self,
        law: ConstrainedLagrangian,
        motion: Motion,
        memory: Memory,
        parameters: Parameters,
        u: Float[Array, "l"],
        h: Scalar,
    ) -> tuple[Motion, Memory]:
        """Take one step."""
        fields, jacobian = memory
        v = _slowed(law, jacobian, motion, h / 2)
        kicked = Motion(motion.x, v + h / 2 * law.over_mass(combine(fields, u)))
        x, middle = constrained_drift(law, kicked, jacobian, parameters, h, self.iterations)
        fields = law.fields(x)
        jacobian = law.jacobian(x, parameters)
        v = tangential(law, jacobian, middle + h / 2 * law.over_mass(combine(fields, u)))
        return Motion(x, _slowed(law, jacobian, Motion(x, v), h / 2)), Memory(fields, jacobian)


def _slowed(
    law: ConstrainedLagrangian, jacobian: Float[Array, "n dim"], motion: Motion, h: Scalar
) -> Float[Array, "dim"]:
    """Return the velocity after h seconds of friction alone."""
    x, v = motion
    if not law.dissipative:
        return v

    def rate(v: Float[Array, "dim"]) -> Float[Array, "dim"]:
        return tangential(law, jacobian, law.over_mass(law.friction(x, v)))

    return v + h * rate(v + h / 2 * rate(v))
