"""What a relation between named keypoints is, and the registry of its kinds: one file a kind in `relations/`."""

import abc
from collections.abc import Sequence
from numbers import Real
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld._entry_points import import_modules, load_entry_points
from keycld._errors import KeycldError, unknown

UNKNOWN = "unknown"
"""In place of a position or a direction: it is learned."""

_ROUNDING = 1e-6
"""Length, image-plane units, below which a distance |y| is rounded off: √(|y|² + ε²) has derivatives at y = 0."""


class AbstractRelation(eqx.Module):
    """One scalar holonomic constraint Φ on the positions of some named keypoints.

    A subclass in a file of `keycld/mechanics/relations/`, or in your own code, with the decorator
    `register_relation`, is all that a new kind of constraint needs.

    Attributes:
        kind: its name in a TOML file.
        required: entries that its table in a TOML file must have.
        optional: entries that it may have; none by default.
    """

    kind: ClassVar[str]
    required: ClassVar[tuple[str, ...]]
    optional: ClassVar[tuple[str, ...]] = ()

    @property
    @abc.abstractmethod
    def keypoints(self) -> tuple[str, ...]:
        """Names of the m keypoints that it reads."""

    @abc.abstractmethod
    def __call__(self, points: Float[Array, "m 2"], parameters: dict[str, Any]) -> Float[Array, ""]:
        """Return Φ, twice differentiable in the positions.

        Args:
            points: positions of `keypoints`, in that order, image-plane units.
            parameters: those of the trajectory's state.
        """

    @property
    def unknowns(self) -> dict[str, Array]:
        """The numbers of its geometry that are learned, by name; none by default."""
        return {}

    def located(self, points: Float[Array, "M m 2"]) -> "AbstractRelation":
        """Return the relation with the unknown numbers of its geometry fitted to observed positions alone.

        Args:
            points: M observations of `keypoints`, image-plane units.
        """
        return self

    @classmethod
    @abc.abstractmethod
    def read(cls, entries: dict[str, Any]) -> "AbstractRelation":
        """Return the relation that the entries of a TOML table describe.

        Args:
            entries: all of `required` and any of `optional`, as `tomllib` gives them.

        Raises:
            KeycldError: if a value does not fit.
        """

    @abc.abstractmethod
    def write(self) -> dict[str, Any]:
        """Return the entries from which `read` makes an equal relation: texts, numbers, or tuples of them."""


class AbstractDisplacement(AbstractRelation):
    """A relation on one displacement y = Σ ±xᵢ − p: its square |y|², or its component n·y along a normal.

    Relations of this form share their arithmetic, so `Constraints` evaluates neighbouring ones at once.
    """

    @property
    @abc.abstractmethod
    def signs(self) -> dict[str, float]:
        """The keypoints it reads, each with its sign in y."""

    @property
    def keypoints(self) -> tuple[str, ...]:
        """The keypoints it reads."""
        return tuple(self.signs)

    @property
    @abc.abstractmethod
    def normal(self) -> tuple[float, float] | Float[Array, "2"] | None:
        """n, or None for the square."""

    @abc.abstractmethod
    def origin(self, parameters: dict[str, Any]) -> Any:
        """Return p [2]."""

    def __call__(self, points: Float[Array, "m 2"], parameters: dict[str, Any]) -> Float[Array, ""]:
        """Return |y|² or n·y."""
        return displacements([self], self.keypoints, points.reshape(-1), parameters)[0]


def displacements(
    relations: Sequence[AbstractDisplacement],
    keypoints: tuple[str, ...],
    x: Float[Array, "dim"],
    parameters: dict[str, Any],
    squared: bool = True,
) -> Float[Array, "n"]:
    """Compute n relations at once: Φ = (s y + n)·y with y = signs · x − p, where s is 1 for a square and 0 otherwise.

    Args:
        relations: n of them.
        keypoints: all K names, in the order of x.
        x: positions [2K].
        parameters: those of the trajectory's state.
        squared: whether Φ is |y|²; otherwise it is the distance √(|y|² + ε²), ε = 1e-6, the derivatives of which exist
            everywhere. Components n·y are what they are.
    """
    signs = np.array([[relation.signs.get(name, 0.0) for name in keypoints] for relation in relations])
    normals = [relation.normal for relation in relations]
    square = np.array([[0.0 if normal is not None else 1.0] * 2 for normal in normals])
    linear = jnp.stack([jnp.asarray((0.0, 0.0) if normal is None else normal, x.dtype) for normal in normals])
    origins = [jnp.asarray(relation.origin(parameters), x.dtype) for relation in relations]
    points = x.reshape(1, -1, 2)
    y = jnp.sum(jnp.asarray(signs, x.dtype)[:, :, None] * points, axis=1) - jnp.stack(origins)
    value = jnp.sum((jnp.asarray(square, x.dtype) * y + linear) * y, axis=1)
    if squared:
        return value
    is_square = square[:, 0] > 0
    return jnp.where(is_square, jnp.sqrt(jnp.where(is_square, value, 0.0) + _ROUNDING**2), value)


_KINDS: dict[str, type[AbstractRelation]] = {}
R = TypeVar("R", bound=AbstractRelation)


def register_relation(relation: type[R]) -> type[R]:
    """Make a class of relations known by its `kind` (a decorator)."""
    _KINDS[relation.kind] = relation
    return relation


def relation_kinds() -> dict[str, type[AbstractRelation]]:
    """Return all known classes of relations by their kind."""
    import_modules("keycld.mechanics.relations")
    load_entry_points("keycld.relations", "kind of constraint")
    return dict(_KINDS)


def relation_of_kind(kind: str) -> type[AbstractRelation]:
    """Return the class of relations of one kind.

    Raises:
        KeycldError: if there is none; it names the nearest.
    """
    kinds = relation_kinds()
    if kind not in kinds:
        raise unknown("kind of constraint", kind, kinds)
    return kinds[kind]


def pair(what: str, value: Any) -> tuple[float, float]:
    """Return two finite numbers.

    Raises:
        KeycldError: for anything else, which the message calls `what`.
    """
    try:
        numbers = tuple(value)
    except TypeError:
        numbers = ()
    if len(numbers) != 2 or not all(isinstance(p, Real) and abs(float(p)) < float("inf") for p in numbers):
        raise KeycldError(f"a {what} is two finite numbers (x, y), not {value!r}.")
    return float(numbers[0]), float(numbers[1])


def keypoint_entry(value: Any) -> str:
    """Return the value of an entry `keypoint`.

    Raises:
        KeycldError: if it is not a text.
    """
    if not isinstance(value, str):
        raise KeycldError(f"'keypoint' is a name in quotes, not {value!r}.")
    return value
