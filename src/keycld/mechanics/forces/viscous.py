"""Friction in proportion to velocity."""

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics.constraints import AbstractConstraint
from keycld.mechanics.force import AbstractDissipationTerm, register_term
from keycld.mechanics.forces.springs import quadratic_form


@register_term
class ViscousFriction(AbstractDissipationTerm):
    """R = ½ Σᵢⱼ Cᵢⱼ vᵢ·vⱼ (Rayleigh 1873): keypoints are slowed by the surroundings, and by each other.

    Attributes:
        coefficients: C [K, K], of which the lower triangle counts. Friction never gives energy where C is positive
            semi-definite; a fit does not enforce it.
    """

    kind = "viscous"
    meaning = "viscous friction of keypoints"
    rank = 1
    viscous = True

    coefficients: Float[Array, "K K"]

    @classmethod
    def zero(cls, constraint: AbstractConstraint, *, key: PRNGKeyArray) -> "ViscousFriction":
        """Return C = 0."""
        count = constraint.dimension // 2
        return cls(jnp.zeros((count, count)))

    def __call__(self, x: Float[Array, "dim"], v: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return ½ Σᵢⱼ Cᵢⱼ vᵢ·vⱼ."""
        return 0.5 * quadratic_form(self.coefficients, v)
