"""Constraint functions Φ(x): relations between named keypoints and plain functions, composed."""

import abc
import itertools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld._errors import KeycldError, unknown
from keycld.mechanics.relation import AbstractDisplacement, AbstractRelation, displacements


class AbstractConstraint(eqx.Module):
    """A constraint function Φ(x, parameters) → [n] on flattened keypoint positions x [2K].

    The dynamics keep Φ at the value of the initial state, so constants (lengths, heights) need not be known
    (paper, end of section 2): only DΦ enters eq. (6), and RATTLE reads the constants from the state.

    Attributes:
        dimension: 2K, the length of x.
    """

    dimension: eqx.AbstractVar[int]

    @property
    @abc.abstractmethod
    def count(self) -> int:
        """Number of scalar constraints, n; zero is allowed."""

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "dim"], parameters: dict[str, Any] | None = None) -> Float[Array, "n"]:
        """Return Φ(x).

        Args:
            x: positions [2K], image-plane units.
            parameters: those of the trajectory's state.
        """

    @property
    def unknowns(self) -> dict[str, Array]:
        """The learned numbers of the geometry, by name; none by default."""
        return {}

    def located(self, x: Float[Array, "M dim"]) -> "AbstractConstraint":
        """Return the constraint with unknown numbers of its geometry fitted to M observed positions alone."""
        return self


class FunctionConstraint(AbstractConstraint):
    """A plain function of the flattened positions as a constraint.

    Args:
        function: `function(x, parameters)` → a number or [n], twice differentiable in x; it may be a module with
            trainable arrays.
        dimension: 2K.

    Raises:
        KeycldError: if the function does not return a number or a vector of floats.
    """

    function: Callable
    dimension: int = eqx.field(static=True)

    @property
    def count(self) -> int:
        """Number of scalar constraints, n, from the shape of Φ.

        Raises:
            KeycldError: if the function reads parameters: then n is known only with a state.
        """
        try:
            return jax.eval_shape(self, jax.ShapeDtypeStruct((self.dimension,), jnp.float32)).shape[0]
        except KeyError as error:
            raise KeycldError(
                f"how many constraints {_name(self.function)} has is known only with the parameter {error}: "
                "take the size of law.constraint(x, parameters)."
            ) from None

    def __call__(self, x: Float[Array, "dim"], parameters: dict[str, Any] | None = None) -> Float[Array, "n"]:
        """Return Φ(x)."""
        value = jnp.asarray(self.function(x, parameters or {}))
        if value.ndim > 1 or not jnp.issubdtype(value.dtype, jnp.floating):
            raise KeycldError(
                f"a constraint function returns a number or a vector of floats, but {_name(self.function)} "
                f"gave {value.dtype} of shape {value.shape}."
            )
        return jnp.atleast_1d(value)


class Constraints(AbstractConstraint):
    """Constraints on named keypoints, stacked into one Φ(x) in the order given.

    Example: a cartpole is `Constraints(("cart", "tip"), (OnLine("cart"), FixedDistance("cart", "tip")))`.
    No item at all is allowed (n = 0): free keypoints, the paper's ablation KeyCLD-NC.

    Args:
        keypoints: names in the order of x.
        items: relations on these names, constraints on all of them in this order, or plain functions
            `function(x, parameters)`. Items of other `Constraints` take their place.
        squared: whether `FixedDistance` and `DistanceToPoint` are squares |y|² (by default) or distances |y|.

    Raises:
        KeycldError: for an unknown, empty or doubled name, no keypoints, or an item of another kind.
    """

    keypoints: tuple[str, ...] = eqx.field(static=True)
    items: tuple[Any, ...]
    squared: bool = eqx.field(static=True)

    def __init__(self, keypoints, items=(), squared=True):
        self.keypoints = _names(keypoints)
        self.squared = squared
        self.items = tuple(self._item(single) for item in items for single in self._singles(item))

    def _singles(self, item: Any) -> tuple[Any, ...]:
        """Return the items of other constraints, or the item itself."""
        if not isinstance(item, Constraints):
            return (item,)
        self._check_known(item.keypoints)
        if item.squared != self.squared:
            raise KeycldError("constraints measured by squares and by distances cannot be joined: choose one for all.")
        if item.keypoints != self.keypoints and not all(isinstance(each, AbstractRelation) for each in item.items):
            raise KeycldError(
                f"constraints with a function of the keypoints {', '.join(item.keypoints)} cannot join those of "
                f"{', '.join(self.keypoints)}: give both the same names in the same order."
            )
        return item.items

    def _check_known(self, names: tuple[str, ...]) -> None:
        for name in names:
            if name not in self.keypoints:
                raise unknown("keypoint", name, self.keypoints)

    def _item(self, item: Any) -> "AbstractRelation | AbstractConstraint":
        if isinstance(item, AbstractRelation):
            self._check_known(item.keypoints)
            return item
        if isinstance(item, AbstractConstraint):
            if item.dimension != self.dimension:
                raise KeycldError(
                    f"a constraint on {item.dimension} coordinates cannot join {len(self.keypoints)} "
                    f"keypoints ({self.dimension} coordinates): give it the same keypoints."
                )
            return item
        return as_constraint(item, self.dimension)

    @property
    def count(self) -> int:
        """Number of scalar constraints, n."""
        return sum(item.count if isinstance(item, AbstractConstraint) else 1 for item in self.items)

    @property
    def dimension(self) -> int:
        """2K."""
        return 2 * len(self.keypoints)

    @property
    def unknowns(self) -> dict[str, Array]:
        """The learned numbers of the relations: `pivot_KEYPOINT` [2], image-plane units; `angle_KEYPOINT`, rad."""
        found = {}
        for item in self.items:
            if isinstance(item, AbstractRelation):
                found |= {f"{name}_{'_'.join(item.keypoints)}": value for name, value in item.unknowns.items()}
            elif isinstance(item, AbstractConstraint):
                found |= item.unknowns
        return found

    def located(self, x: Float[Array, "M dim"]) -> "Constraints":
        """Return the constraints with unknown pivots and directions fitted to observed positions alone.

        Args:
            x: observed positions [M, 2K], image-plane units.
        """
        items = (
            item.located(x.reshape(len(x), -1, 2)[:, self._index(item)])
            if isinstance(item, AbstractRelation)
            else item.located(x)
            for item in self.items
        )
        return Constraints(self.keypoints, items, self.squared)

    def distances(self) -> "Constraints":
        """Return the same constraints, measured by distances |y| in place of squares |y|².

        Both describe the same motions: the rows of DΦ differ only in length. The released code of arXiv v1 uses
        distances. |y| is rounded off to √(|y|² + 10⁻¹²), so that its derivatives exist where two keypoints meet;
        squares remain the better choice near such a point. Components along a line, other relations and functions
        stay as they are.
        """
        return Constraints(self.keypoints, self.items, squared=False)

    def __call__(self, x: Float[Array, "dim"], parameters: dict[str, Any] | None = None) -> Float[Array, "n"]:
        """Return Φ(x), the items' values one after another."""
        parameters = parameters or {}
        values = [x[:0]]
        for together, items in itertools.groupby(self.items, lambda item: isinstance(item, AbstractDisplacement)):
            if together:
                values.append(displacements(list(items), self.keypoints, x, parameters, self.squared))
            else:
                values += [self._value(item, x, parameters) for item in items]
        return jnp.concatenate(values)

    def _value(self, item: AbstractRelation | AbstractConstraint, x: Array, parameters: dict[str, Any]) -> Array:
        if isinstance(item, AbstractConstraint):
            return item(x, parameters)
        return item(x.reshape(-1, 2)[self._index(item)], parameters)[None]

    def _index(self, item: AbstractRelation) -> Array:
        return jnp.array([self.keypoints.index(name) for name in item.keypoints])


def as_constraint(constraint: Any, dimension: int) -> AbstractConstraint:
    """Return the constraint itself, or a plain function made into one.

    Raises:
        KeycldError: if it is neither, or belongs to another number of coordinates.
    """
    if isinstance(constraint, AbstractConstraint):
        if constraint.dimension != dimension:
            raise KeycldError(
                f"the constraint is for {constraint.dimension} coordinates, the system has {dimension}: "
                f"use the same keypoints for both."
            )
        return constraint
    if callable(constraint):
        return FunctionConstraint(function=constraint, dimension=dimension)
    raise KeycldError(
        f"'{type(constraint).__name__}' is no constraint: give a relation such as FixedDistance, "
        f"or a function of (x, parameters)."
    )


def _name(function: Callable) -> str:
    return getattr(function, "__name__", type(function).__name__)


def _names(names: Any) -> tuple[str, ...]:
    if isinstance(names, str):
        raise KeycldError(f"keypoints are a list of names, not the one text '{names}': write ('{names}',).")
    names = tuple(names)
    if not names:
        raise KeycldError("a system needs at least one keypoint: name it.")
    for name in names:
        if not isinstance(name, str) or not name.strip():
            raise KeycldError(f"the name of a keypoint is a text that is not empty, not {name!r}.")
    if len(set(names)) < len(names):
        doubled = next(name for name in names if names.count(name) > 1)
        raise KeycldError(f"the keypoint '{doubled}' is named twice: names must differ.")
    return names
