"""Springs that act in proportion to displacements."""

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics.constraints import AbstractConstraint
from keycld.mechanics.force import AbstractPotentialTerm, register_term


@register_term
class Springs(AbstractPotentialTerm):
    """V = ½ Σᵢⱼ Sᵢⱼ xᵢ·xⱼ: springs between keypoints and to fixed points, of rest length zero or along a line.

    With the affine part of V it is any sum of ½k|xᵢ − p|² and ½k|xᵢ − xⱼ|².

    Attributes:
        stiffness: S [K, K], of which the lower triangle counts.
    """

    kind = "springs"
    meaning = "springs between keypoints and to fixed points"

    stiffness: Float[Array, "K K"]

    @classmethod
    def zero(cls, constraint: AbstractConstraint, *, key: PRNGKeyArray) -> "Springs":
        """Return S = 0."""
        count = constraint.dimension // 2
        return cls(jnp.zeros((count, count)))

    def __call__(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return ½ Σᵢⱼ Sᵢⱼ xᵢ·xⱼ."""
        return 0.5 * quadratic_form(self.stiffness, x)


def quadratic_form(lower: Float[Array, "K K"], x: Float[Array, "dim"]) -> Float[Array, ""]:
    """Return Σᵢⱼ Sᵢⱼ xᵢ·xⱼ, S the symmetric matrix with this lower triangle."""
    points = x.reshape(-1, 2)
    symmetric = jnp.tril(lower) + jnp.tril(lower, -1).T
    return jnp.sum(symmetric[:, :, None] * points[:, None] * points[None, :])
