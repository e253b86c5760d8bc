"""Drag in a fluid."""

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics.constraints import AbstractConstraint
from keycld.mechanics.force import AbstractDissipationTerm, register_term


@register_term
class Drag(AbstractDissipationTerm):
    """R = ⅓ Σᵢ dᵢ |vᵢ|³: a force dᵢ |vᵢ|² against the motion, such as that of air at high Reynolds numbers.

    Attributes:
        strength: d [K].
    """

    kind = "drag"
    meaning = "drag, in proportion to the square of the speed"
    rank = 4

    strength: Float[Array, "K"]

    @classmethod
    def zero(cls, constraint: AbstractConstraint, *, key: PRNGKeyArray) -> "Drag":
        """Return d = 0."""
        return cls(jnp.zeros((constraint.dimension // 2,)))

    def __call__(self, x: Float[Array, "dim"], v: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return ⅓ Σᵢ dᵢ |vᵢ|³."""
        squared = jnp.sum(v.reshape(-1, 2) ** 2, axis=1)
        return jnp.sum(self.strength * squared * jnp.sqrt(squared + 1e-12)) / 3
