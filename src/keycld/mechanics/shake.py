"""SHAKE: Störmer–Verlet steps whose positions satisfy the constraints."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics.integrators import AbstractIntegrator, Parameters
from keycld.mechanics.lagrangian import AbstractLaw, ConstrainedLagrangian, combine
from keycld.mechanics.linear import factor, gram, substitute, times
from keycld.mechanics.state import Motion, Scalar

_LARGEST_TURN = 0.5
"""Largest angle, radians, by which a drift may turn a part. One part has no solution beyond 90°, two parts that turn
against each other none beyond 45°."""


def constrained_drift(
    law: ConstrainedLagrangian,
    motion: Motion,
    jacobian: Float[Array, "n dim"],
    parameters: Parameters,
    h: Scalar,
    iterations: int,
) -> Motion:
    """Drift for h seconds onto the constraints: v' = v + M⁻¹DΦ(x)ᵀλ, x' = x + h v', Φ(x') = constants.

    The first λ solves the constraints linearised at x; steps of Newton's method follow, with the exact matrix
    DΦ(x') M⁻¹ DΦ(x)ᵀ. Derivatives flow through the last step alone: first derivatives are those of the
    implicit function theorem at the price of one step; second ones are not right.

    A drift that turns a part by more than 0.5 rad (measured by the change of DΦ), or whose first position is too far
    off the constants, is shortened to that limit: the result is finite, but too slow. More sub-steps avoid this.

    Raises:
        KeycldError: if the parameters have no `constants`.
    """
    x, v = motion
    if jacobian.shape[0] == 0:
        return Motion(x + h * v, v)
    if "constants" not in parameters:
        raise KeycldError(
            "SHAKE and RATTLE hold Φ at the constants of the state, but its parameters have no 'constants': "
            "add law.constraint(x, parameters) of the initial state."
        )
    pull = law.over_mass(jacobian)
    value = law.constraint(x, parameters)
    offset = parameters["constants"] - value
    share, multipliers, newton = jax.lax.stop_gradient(
        _multipliers(law, *jax.lax.stop_gradient((x, v, jacobian, pull, offset)), parameters, h, iterations)
    )
    target = value + share * offset
    v = share * v + times(pull.T, multipliers)
    v = v + times(pull.T, substitute(newton, target - law.constraint(x + h * v, parameters))) / h
    return Motion(x + h * v, v)


def check_iterations(iterations: int) -> None:
    """Refuse anything but a whole number of iterations, at least one."""
    if not isinstance(iterations, int) or iterations < 1:
        raise KeycldError(f"Newton's method takes 1 or more iterations a sub-step, not {iterations!r}.")


def _multipliers(law, x, v, jacobian, pull, offset, parameters, h, iterations):
    """Return the share of the drift that is possible, λ before the last step of Newton's method, and its matrix."""
    straight = factor(gram(jacobian, pull))
    linear = substitute(straight, offset / h - times(jacobian, v))
    bent = law.jacobian(x + h * (v + times(pull.T, linear)), parameters) - jacobian
    turned = jnp.sum(bent * law.over_mass(bent), axis=1)
    size = jnp.sum(jacobian * pull, axis=1)
    over = (turned > _LARGEST_TURN**2 * size) & (size > 0)
    share = jnp.min(jnp.where(over, _LARGEST_TURN * jnp.sqrt(size / jnp.where(over, turned, 1.0)), 1.0))

    target = law.constraint(x, parameters) + share * offset
    v, multipliers = share * v, share * linear
    newton = factor(gram(jacobian + share * bent, pull), straight.inverse_pivots)
    for _ in range(iterations - 1):
        ahead = x + h * (v + times(pull.T, multipliers))
        multipliers = multipliers + substitute(newton, target - law.constraint(ahead, parameters)) / h
        ahead = x + h * (v + times(pull.T, multipliers))
        newton = factor(gram(law.jacobian(ahead, parameters), pull), straight.inverse_pivots)
    return share, multipliers, newton


class Shake(AbstractIntegrator):
    """SHAKE in velocity form (Ryckaert, Ciccotti and Berendsen 1977): the positions of RATTLE for less work.

    v½ = v + h/2 M⁻¹f(x) + M⁻¹DΦ(x)ᵀλ,   x' = x + h v½ with Φ(x') = constants,   v' = v½ + h/2 M⁻¹f(x').

    Order 2, symplectic, reversible. The velocity keeps a component along the constraint forces, which the next λ
    removes: read positions from a roll-out, and energies only after `law.project_velocity`.

    Attributes:
        substeps: steps a frame.
        iterations: of Newton's method; 3 hold Φ to float32 for rotations up to 0.3 rad a sub-step.
    """

    substeps: int = eqx.field(static=True, default=1)
    iterations: int = eqx.field(static=True, default=3)

    def __check_init__(self):
        """Refuse less than one iteration."""
        check_iterations(self.iterations)

    def initial_memory(self, law: AbstractLaw, motion: Motion, parameters: Parameters, h: Scalar) -> Any:
        """Return the fields and DΦ at the initial position.

        Raises:
            KeycldError: for a law with damping, or one that is not a `ConstrainedLagrangian`.
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
        """Take one step."""
        fields, jacobian = memory
        kicked = Motion(motion.x, motion.v + h / 2 * law.over_mass(combine(fields, u)))
        x, middle = constrained_drift(law, kicked, jacobian, parameters, h, self.iterations)
        fields = law.fields(x)
        return Motion(x, middle + h / 2 * law.over_mass(combine(fields, u))), (fields, law.jacobian(x, parameters))
