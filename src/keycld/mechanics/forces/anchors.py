"""Springs with a rest length from keypoints to fixed points."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics.constraints import AbstractConstraint
from keycld.mechanics.force import AbstractPotentialTerm, register_term

_CLOSE = 0.02
"""Distance, image-plane units, below which |x − p| is rounded off."""


@register_term
class Anchors(AbstractPotentialTerm):
    """V = Σᵢ aᵢ |xᵢ − pᵢ|: with `springs`, a spring of stiffness k and rest length l to a point p has a = −k l.

    Attributes:
        strength: a [K].
        point: p [K, 2], image-plane units; it may be outside of the picture.
    """

    kind = "anchors"
    meaning = "springs with a rest length to fixed points"
    rank = 6
    nonlinear = ("point",)

    strength: Float[Array, "K"]
    point: Float[Array, "K 2"]

    @classmethod
    def zero(cls, constraint: AbstractConstraint, *, key: PRNGKeyArray) -> "Anchors":
        """Return no force, with all points in the image centre."""
        count = constraint.dimension // 2
        return cls(jnp.zeros((count,)), jnp.zeros((count, 2)))

    def candidates(self) -> "tuple[Anchors, ...]":
        """Return the same term with its points on a grid over the picture and around it."""
        grid = np.linspace(-1.5, 1.5, 7)
        points = [jnp.broadcast_to(jnp.array([x, y]), self.point.shape) for x in grid for y in grid]
        return tuple(eqx.tree_at(lambda term: term.point, self, point) for point in points)

    def __call__(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return Σᵢ aᵢ |xᵢ − pᵢ|."""
        apart = x.reshape(-1, 2) - self.point
        return jnp.sum(self.strength * jnp.sqrt(jnp.sum(apart**2, axis=1) + _CLOSE**2))
