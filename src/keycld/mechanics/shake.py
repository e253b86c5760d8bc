"""SHAKE: Störmer–Verlet steps whose positions satisfy the constraints."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics.integrators import AbstractIntegrator, Parameters
from keycld.mechanics.lagrangian import ConstrainedLagrangian, combine
from keycld.mechanics.linear import factor, gram, substitute, times
from keycld.mechanics.state import Motion, Scalar


def constrained_drift(
    law: ConstrainedLagrangian,
    motion: Motion,
    jacobian: Float[Array, "n dim"],
    parameters: Parameters,
    h: Scalar,
    iterations: int,
) -> Motion:
    """Drift for h seconds onto the constraints: v' = v + M⁻¹DΦ(x)ᵀλ, x' = x + h v', Φ(x') = constants.

    Newton's method for λ, with the exact matrix DΦ(x') M⁻¹ DΦ(x)ᵀ, unrolled. Derivatives flow through the
    last iteration alone: first derivatives are those of the implicit function theorem at the price of one
    iteration; second derivatives are not right. Where a step turns a part by more than 60°, there may be no
    solution, and the bounded pivots keep the result finite; sub-steps are the mend.
    """
    x, v = motion
    if jacobian.shape[0] == 0:
        return Motion(x + h * v, v)
    if "constants" not in parameters:
        raise KeycldError(
            "SHAKE and RATTLE hold Φ at the constants of the state, but its parameters have no 'constants': "
            "add law.constraint(x, parameters) of the start."
        )
    constants = parameters["constants"]
    pull = law.inverse_mass[None, :] * jacobian
    frozen = jax.lax.stop_gradient((x, v, pull, jacobian))

    def newton_matrix(multipliers):
        x, v, pull, _ = frozen
        ahead = x + h * (v + times(pull.T, multipliers))

        def twice(y):
            value = law.constraint(y, parameters)
            return value, value

        slope, value = jax.jacfwd(twice, has_aux=True)(ahead)
        return jax.lax.stop_gradient((gram(slope, pull), constants - value))

    reference = factor(gram(frozen[3], frozen[2])).inverse_pivots
    multipliers = jnp.zeros_like(constants)
    for _ in range(iterations - 1):
        matrix, defect = newton_matrix(multipliers)
        multipliers = multipliers + substitute(factor(matrix, reference), defect / h)
    matrix, _ = newton_matrix(multipliers)
    near = v + times(pull.T, multipliers)
    defect = constants - law.constraint(x + h * near, parameters)
    v = near + times(pull.T, substitute(factor(matrix, reference), defect / h))
    return Motion(x + h * v, v)


class Shake(AbstractIntegrator):
    """SHAKE in velocity form (Ryckaert, Ciccotti and Berendsen 1977): the positions of RATTLE for less work.

    v½ = v + h/2 M⁻¹f(x) + M⁻¹DΦ(x)ᵀλ,   x' = x + h v½ with Φ(x') = constants,   v' = v½ + h/2 M⁻¹f(x').

    Order 2, symplectic, reversible. The velocity keeps a part along the constraint forces, which the next λ
    absorbs: read positions from a roll-out, and energies only after `law.project_velocity`.

    Attributes:
        substeps: steps a frame.
        iterations: of Newton's method; 3 hold Φ to float32 for rotations up to 0.3 rad a sub-step.
    """

    substeps: int = eqx.field(static=True, default=1)
    iterations: int = eqx.field(static=True, default=3)

    def begin(self, law: ConstrainedLagrangian, motion: Motion, parameters: Parameters, h: Scalar) -> Any:
        """Fields and DΦ at the start.

        Raises:
            KeycldError: for a law with damping.
        """
        if not isinstance(law, ConstrainedLagrangian):
            raise KeycldError(f"SHAKE integrates point masses, not a {type(law).__name__}: use RK4.")
        if law.dissipative:
            raise KeycldError(
                "SHAKE follows positions alone and cannot damp velocities: use Rattle for a law with damping."
            )
        return law.fields(motion.x), law.jacobian(motion.x, parameters)

    def advance(
        self,
        law: ConstrainedLagrangian,
        motion: Motion,
        memory: Any,
        parameters: Parameters,
        u: Float[Array, "l"],
        h: Scalar,
    ) -> tuple[Motion, Any]:
        """One step."""
        fields, jacobian = memory
        kick = h / 2 * law.inverse_mass
        start = Motion(motion.x, motion.v + kick * combine(fields, u))
        x, middle = constrained_drift(law, start, jacobian, parameters, h, self.iterations)
        fields = law.fields(x)
        return Motion(x, middle + kick * combine(fields, u)), (fields, law.jacobian(x, parameters))
