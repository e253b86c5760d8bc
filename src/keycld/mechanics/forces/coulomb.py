"""Dry friction."""

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics.constraints import AbstractConstraint
from keycld.mechanics.force import AbstractDissipationTerm, register_term

_SLOW = 0.05
"""ε, image-plane units a second: below it the force falls to zero."""


@register_term
class CoulombFriction(AbstractDissipationTerm):
    """R = Σᵢ cᵢ √(|vᵢ|² + ε²): dry friction, a force cᵢ against the motion whatever the speed, smooth below ε.

    Attributes:
        strength: c [K].
    """

    kind = "coulomb"
    meaning = "dry friction"
    rank = 3

    strength: Float[Array, "K"]

    @classmethod
    def zero(cls, constraint: AbstractConstraint, *, key: PRNGKeyArray) -> "CoulombFriction":
        """Return c = 0."""
        return cls(jnp.zeros((constraint.dimension // 2,)))

    def __call__(self, x: Float[Array, "dim"], v: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return Σᵢ cᵢ √(|vᵢ|² + ε²)."""
        return jnp.sum(self.strength * jnp.sqrt(jnp.sum(v.reshape(-1, 2) ** 2, axis=1) + _SLOW**2))
