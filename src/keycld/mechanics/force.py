"""What a term of the energies is, sums of terms, and their registry: one file a term in `forces/`."""

import abc
from collections.abc import Mapping, Sequence
from typing import ClassVar, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld._entry_points import import_modules, load_entry_points
from keycld._errors import unknown
from keycld.mechanics.constraints import AbstractConstraint
from keycld.mechanics.lagrangian import ConstrainedLagrangian


class AbstractTerm(eqx.Module):
    """A term of the potential energy V(x) or of the dissipation function R(x, v), with parameters that are fitted.

    A subclass in a file of `keycld/mechanics/forces/`, or in a package with an entry point of the group
    `keycld.forces`, with the decorator `register_term`, is all that a new kind of force needs: training tries it where
    the motion asks for it. Terms should be linear in most of their parameters, so that least squares finds these from
    anywhere.

    Attributes:
        kind: its name in settings and reports.
        meaning: what it describes, in a few words, for reports.
        tried: whether training tries it together with the others.
        rank: of two kinds that explain a motion alike, the one with the lower rank stays.
        nonlinear: names of the parameters that it is not linear in. Where all others are zero it has no effect.
    """

    kind: ClassVar[str]
    meaning: ClassVar[str]
    nonlinear: ClassVar[tuple[str, ...]] = ()
    tried: ClassVar[bool] = True
    rank: ClassVar[int] = 0

    @classmethod
    @abc.abstractmethod
    def zero(cls, constraint: AbstractConstraint, *, key: PRNGKeyArray) -> "AbstractTerm | None":
        """Return the term with no effect yet, or None if it has no meaning for these keypoints.

        Args:
            constraint: of the mechanism, which names the keypoints and says what is linked.
            key: for random weights.
        """

    def candidates(self) -> "tuple[AbstractTerm, ...]":
        """Return variants of the term that differ in parameters it is not linear in; only itself by default.

        The first guess of a fit tries each.
        """
        return (self,)


class AbstractPotentialTerm(AbstractTerm):
    """A term of V."""

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return its part of V(x); its force is −∂V/∂x."""


class AbstractDissipationTerm(AbstractTerm):
    """A term of R, Rayleigh's dissipation function and its generalisations.

    Attributes:
        viscous: whether its force is in proportion to the velocities, so that it has a rate in 1/s.
    """

    viscous: ClassVar[bool] = False

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "dim"], v: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return its part of R(x, v); its force is −∂R/∂v."""


class SumPotential(eqx.Module):
    """V(x) = w·x + Σ terms: gravity in any direction, and what else there is.

    Attributes:
        weight: w [2K].
        terms: by kind.
    """

    weight: Float[Array, "dim"]
    terms: dict[str, AbstractPotentialTerm]

    def __call__(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return V(x)."""
        return sum((term(x) for term in self.terms.values()), jnp.sum(self.weight * x))


class SumDissipation(eqx.Module):
    """R(x, v) = Σ terms.

    Attributes:
        terms: by kind, at least one.
    """

    terms: dict[str, AbstractDissipationTerm]

    def __call__(self, x: Float[Array, "dim"], v: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return R(x, v)."""
        return sum((term(x, v) for term in self.terms.values()), jnp.zeros(()))


def terms_of(law: ConstrainedLagrangian) -> dict[str, AbstractTerm]:
    """Return the terms of V and R by kind, without the affine part of V."""
    found: dict[str, AbstractTerm] = {}
    if isinstance(law.potential, SumPotential):
        found |= law.potential.terms
    if isinstance(law.dissipation, SumDissipation):
        found |= law.dissipation.terms
    return found


def with_terms(law: ConstrainedLagrangian, terms: Mapping[str, AbstractTerm]) -> ConstrainedLagrangian:
    """Return a law whose V is a `SumPotential` with these terms of V and R in place of its own."""
    assert isinstance(law.potential, SumPotential)
    potential = SumPotential(
        law.potential.weight, {kind: term for kind, term in terms.items() if isinstance(term, AbstractPotentialTerm)}
    )
    slowing = {kind: term for kind, term in terms.items() if isinstance(term, AbstractDissipationTerm)}
    dissipation = SumDissipation(slowing) if slowing else None
    return ConstrainedLagrangian(law.mass, potential, law.input_matrix, law.constraint_function, dissipation)


def with_kinds(law: ConstrainedLagrangian, kinds: Sequence[str], *, key: PRNGKeyArray) -> ConstrainedLagrangian:
    """Return a law with terms of these kinds added, without effect yet; those without meaning for it are left out.

    Raises:
        KeycldError: for an unknown kind.
    """
    made = {kind: term_of_kind(kind).zero(law.constraint_function, key=key) for kind in kinds}
    return with_terms(law, terms_of(law) | {kind: term for kind, term in made.items() if term is not None})


_KINDS: dict[str, type[AbstractTerm]] = {}
T = TypeVar("T", bound=AbstractTerm)


def register_term(term: type[T]) -> type[T]:
    """Make a class of terms known by its `kind` (a decorator)."""
    _KINDS[term.kind] = term
    return term


def term_kinds() -> dict[str, type[AbstractTerm]]:
    """Return all known classes of terms by their kind."""
    import_modules("keycld.mechanics.forces")
    load_entry_points("keycld.forces", "force")
    return dict(_KINDS)


def term_of_kind(kind: str) -> type[AbstractTerm]:
    """Return the class of terms of one kind.

    Raises:
        KeycldError: if there is none; it names the nearest.
    """
    kinds = term_kinds()
    if kind not in kinds:
        raise unknown("kind of force", kind, kinds)
    return kinds[kind]
