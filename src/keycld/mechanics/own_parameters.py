"""Parameters of a law that differ by trajectory: where it acts, how heavy the keypoints are, how strong friction is."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.mechanics.circle import nearest_circle
from keycld.mechanics.constraints import AbstractConstraint, Constraints
from keycld.mechanics.force import SumPotential
from keycld.mechanics.lagrangian import ConstrainedLagrangian
from keycld.mechanics.masses import AbstractMassMatrix
from keycld.mechanics.relations.distance_to_point import DistanceToPoint


class Own(NamedTuple):
    """What a fit knows of the own parameters ζ of each motion, S = K + 3 numbers (`own_parameters`).

    Attributes:
        numbers: where the fit begins.
        expected: ζ̄, the mean of the normal prior.
        precision: Λ, its inverse covariance times the variance of an observed coordinate, image-plane units squared.
    """

    numbers: Float[Array, "N S"]
    expected: Float[Array, "N S"]
    precision: Float[Array, "S S"]


def own_parameters(numbers: Float[Array, "S"]) -> dict[str, Array]:
    """Return the entries of a state's parameters for ζ = (p, log μ, log φ), S = K + 3 numbers.

    Args:
        numbers: ζ.

    Returns:
        `place` p [2], image-plane units; `masses` μ [K], factors of the masses; `friction` φ [], the factor of R.
    """
    return {"place": numbers[:2], "masses": jnp.exp(numbers[2:-1]), "friction": jnp.exp(numbers[-1])}


def own_law(law: Any, parameters: dict[str, Any] | None) -> Any:
    """Return the law of one trajectory; the law itself where the state's parameters hold no place.

        L = ½ vᵀ M_μ v − V(x − p),   M_μ = √μ M √μ,   Φ(x − p),   φ R(x − p, v),   g(x − p)

    (M, V, g, R) is known up to one factor, so μ of a single keypoint stands for the strength of V too: a stiffness over
    a mass, or gravity. What is heavier also weighs more: the weights w of a `SumPotential` are μ_k w_k / μ_1 here, so
    that a ratio of masses changes no gravity.

    Args:
        law: a `ConstrainedLagrangian`; other laws have no own parameters.
        parameters: of the trajectory's state, with p, μ and φ as in `own_parameters`.
    """
    if not parameters or "place" not in parameters:
        return law
    assert isinstance(law, ConstrainedLagrangian)
    place = parameters["place"]
    return ConstrainedLagrangian(
        mass=_OwnMasses(law.mass, jnp.sqrt(parameters["masses"])),
        potential=_Elsewhere(_weighed(law.potential, parameters["masses"]), place),
        input_matrix=None if law.input_matrix is None else _Elsewhere(law.input_matrix, place),
        constraint=_ConstraintElsewhere(
            dimension=law.constraint_function.dimension, constraint=law.constraint_function, place=place
        ),
        dissipation=None if law.dissipation is None else _Friction(law.dissipation, place, parameters["friction"]),
    )


def _weighed(potential: Callable, masses: Float[Array, "K"]) -> Callable:
    """Return V with weights in proportion to the factors of masses; that of the first keypoint stays."""
    if not isinstance(potential, SumPotential):
        return potential
    return SumPotential(potential.weight * jnp.repeat(masses / masses[0], 2), potential.terms)


def rough_places(law: ConstrainedLagrangian, observed: Float[Array, "N T dim"]) -> Float[Array, "N 2"]:
    """Return a first guess of each trajectory's place, from its positions alone.

    It is the centre of the circle on which the first keypoint with a `DistanceToPoint` moves; without one, the mean of
    all positions.
    """
    points = observed.reshape(*observed.shape[:2], -1, 2)
    phi = law.constraint_function
    relations = phi.items if isinstance(phi, Constraints) else ()
    names = phi.keypoints if isinstance(phi, Constraints) else ()
    for item in relations:
        if isinstance(item, DistanceToPoint) and isinstance(item.point, tuple):
            of_keypoint = points[:, :, names.index(item.keypoint)]
            return jax.vmap(lambda own: nearest_circle(own)[0])(of_keypoint) - jnp.array(item.point)[None]
    return jnp.mean(points, axis=(1, 2))


def moved(x: Float[Array, "*n dim"], place: Float[Array, "2"]) -> Float[Array, "*n dim"]:
    """Return x − p for each keypoint."""
    return (x.reshape(-1, 2) - place[None]).reshape(x.shape)


class _Elsewhere(eqx.Module):
    """A function of positions, around another place."""

    function: Callable
    place: Float[Array, "2"]

    def __call__(self, x: Array) -> Array:
        return self.function(moved(x, self.place))


class _Friction(eqx.Module):
    """R around another place, times a factor."""

    function: Callable
    place: Float[Array, "2"]
    factor: Float[Array, ""]

    def __call__(self, x: Array, v: Array) -> Array:
        return self.factor * self.function(moved(x, self.place), v)


class _ConstraintElsewhere(AbstractConstraint):
    """Φ around another place."""

    dimension: int = eqx.field(static=True)
    constraint: AbstractConstraint
    place: Float[Array, "2"]

    @property
    def count(self) -> int:
        return self.constraint.count

    def __call__(self, x: Array, parameters: dict[str, Any] | None = None) -> Array:
        return self.constraint(moved(x, self.place), parameters)


class _OwnMasses(AbstractMassMatrix):
    """√μ m √μ."""

    mass: AbstractMassMatrix
    root: Float[Array, "K"]

    coupled = True

    @property
    def matrix(self) -> Array:
        return self.mass.matrix * jnp.outer(self.root, self.root)

    @property
    def inverse(self) -> Array:
        return self.mass.inverse / jnp.outer(self.root, self.root)

    def nearest(self, matrix: Any) -> AbstractMassMatrix:
        return self.mass.nearest(matrix)
