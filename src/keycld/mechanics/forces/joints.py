"""Friction of hinges."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics.constraints import AbstractConstraint, Constraints
from keycld.mechanics.force import AbstractDissipationTerm, register_term
from keycld.mechanics.relations.distance_to_point import DistanceToPoint
from keycld.mechanics.relations.fixed_distance import FixedDistance


@register_term
class JointFriction(AbstractDissipationTerm):
    """R = ½ Σ_h b_h (Σ_k H_hk ω_k)²: viscous friction of hinges, in proportion to their angular velocity.

    A link is a constraint `FixedDistance` or `DistanceToPoint`; d is the vector along it and ω = d × ḋ / |d|² its
    angular velocity. The hinges: of each link against the surroundings, and of each two links that share a keypoint
    against each other. A link to an unknown point is left out: friction of its end (`viscous`) is the same.

    Attributes:
        strength: b [hinges].
        signs: the vectors along the links, [links][K] combinations of the keypoints.
        origins: [links], the fixed point of each link, (0, 0) without one.
        hinges: H [hinges][links].
    """

    kind = "joints"
    meaning = "viscous friction of hinges"
    rank = 2
    viscous = True

    strength: Float[Array, "hinges"]
    signs: tuple[tuple[float, ...], ...] = eqx.field(static=True)
    origins: tuple[tuple[float, float], ...] = eqx.field(static=True)
    hinges: tuple[tuple[float, ...], ...] = eqx.field(static=True)

    @classmethod
    def zero(cls, constraint: AbstractConstraint, *, key: PRNGKeyArray) -> "JointFriction | None":
        """Return no friction; None without links."""
        links = hinged_links(constraint)
        if not links:
            return None
        assert isinstance(constraint, Constraints)
        signs = tuple(tuple(link.signs.get(name, 0.0) for name in constraint.keypoints) for link in links)
        single = np.eye(len(links))
        shared = [
            single[i] - single[j]
            for i in range(len(links))
            for j in range(i)
            if set(links[i].keypoints) & set(links[j].keypoints)
        ]
        hinges = tuple(tuple(row.tolist()) for row in (*single, *shared))
        return cls(jnp.zeros((len(hinges),)), signs, tuple(link.origin({}) for link in links), hinges)

    def __call__(self, x: Float[Array, "dim"], v: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return ½ Σ_h b_h (Σ_k H_hk ω_k)²."""
        signs = jnp.array(self.signs, x.dtype)[:, :, None]
        along = jnp.sum(signs * x.reshape(1, -1, 2), axis=1) - jnp.array(self.origins, x.dtype)
        rate = jnp.sum(signs * v.reshape(1, -1, 2), axis=1)
        turning = (along[:, 0] * rate[:, 1] - along[:, 1] * rate[:, 0]) / (jnp.sum(along**2, axis=1) + 1e-6)
        hinges = jnp.sum(jnp.array(self.hinges, x.dtype) * turning[None, :], axis=1)
        return 0.5 * jnp.sum(self.strength * hinges**2)


def hinged_links(constraint: AbstractConstraint) -> list[FixedDistance | DistanceToPoint]:
    """Return the links whose hinges have friction of their own: those that hang on no unknown point."""
    items = constraint.items if isinstance(constraint, Constraints) else ()
    links = [item for item in items if isinstance(item, (FixedDistance, DistanceToPoint))]
    return [link for link in links if isinstance(link.origin({}), tuple)]
