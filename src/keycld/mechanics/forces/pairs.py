"""Forces between two keypoints along the line through them."""

import itertools

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics.constraints import AbstractConstraint, Constraints
from keycld.mechanics.force import AbstractPotentialTerm, register_term
from keycld.mechanics.relations.fixed_distance import FixedDistance

_CLOSE = 0.02
"""Distance, image-plane units, below which r is rounded off: r = √(|d|² + ε²)."""


@register_term
class PairForces(AbstractPotentialTerm):
    """V = Σ_{i<j} a r + b log r + c / r with r = |xᵢ − xⱼ − o|: rest lengths of springs, attraction, repulsion.

    Forces act between the centres of bodies, and a keypoint that nothing binds may be anywhere on its own: o is what
    lies between the two centres when the keypoints are in one place. Two keypoints at a fixed distance are no pair: a
    force along the line through them changes no motion.

    Attributes:
        strength: (a, b, c) of each pair [pairs, 3].
        offset: o of each pair [pairs, 2], image-plane units.
        first: indices i of the pairs.
        second: indices j.
    """

    kind = "pairs"
    meaning = "forces along the line through two keypoints"
    rank = 5
    nonlinear = ("offset",)

    strength: Float[Array, "pairs 3"]
    offset: Float[Array, "pairs 2"]
    first: tuple[int, ...] = eqx.field(static=True)
    second: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def zero(cls, constraint: AbstractConstraint, *, key: PRNGKeyArray) -> "PairForces | None":
        """Return no force; None without pairs."""
        fixed = _fixed(constraint)
        pairs = [pair for pair in itertools.combinations(range(constraint.dimension // 2), 2) if pair not in fixed]
        if not pairs:
            return None
        first, second = zip(*pairs, strict=True)
        return cls(jnp.zeros((len(pairs), 3)), jnp.zeros((len(pairs), 2)), first, second)

    def __call__(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return the sum over all pairs."""
        points = x.reshape(-1, 2)
        apart = points[jnp.array(self.first)] - points[jnp.array(self.second)] - self.offset
        r = jnp.sqrt(jnp.sum(apart**2, axis=1) + _CLOSE**2)
        return jnp.sum(self.strength * jnp.stack([r, jnp.log(r), 1 / r], axis=1))


def _fixed(constraint: AbstractConstraint) -> set[tuple[int, ...]]:
    """Return the pairs of keypoints at a fixed distance."""
    if not isinstance(constraint, Constraints):
        return set()
    links = [item.keypoints for item in constraint.items if isinstance(item, FixedDistance)]
    return {tuple(sorted(constraint.keypoints.index(name) for name in link)) for link in links}
