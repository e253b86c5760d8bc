"""Constraint functions Φ(x): relations between named keypoints and plain functions, composed."""

import abc
import itertools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld._errors import KeycldError, unknown
from keycld.mechanics.relations import AbstractRelation


class AbstractConstraint(eqx.Module):
    """A constraint function Φ(x, parameters) → [n] on flattened keypoint positions x [2K].

    The dynamics keep Φ at the value it has at the start, so constants (lengths, heights) need not be known
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
        """Φ(x). `parameters` are those of the trajectory's state."""


class FunctionConstraint(AbstractConstraint):
    """A plain function of the flattened positions as a constraint.

    Args:
        function: `function(x, parameters)` → a number or [n]; differentiable twice in x. A module with
            trainable arrays is welcome.
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
            KeycldError: if the function reads parameters, for then only a state tells it.
        """
        try:
            return jax.eval_shape(self, jax.ShapeDtypeStruct((self.dimension,), jnp.float32)).shape[0]
        except KeyError as error:
            raise KeycldError(
                f"how many constraints {_name(self.function)} has is known only with the parameter {error}: "
                "take the size of law.constraint(x, parameters)."
            ) from None

    def __call__(self, x: Float[Array, "dim"], parameters: dict[str, Any] | None = None) -> Float[Array, "n"]:
        """Φ(x)."""
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
        items: relations on these names, other constraints of the same dimension, or plain functions
            `function(x, parameters)`.

    Raises:
        KeycldError: for an unknown, empty or doubled name, no keypoints, or an item of another kind.
    """

    keypoints: tuple[str, ...] = eqx.field(static=True)
    items: tuple[Any, ...]

    def __init__(self, keypoints, items=()):
        self.keypoints = _names(keypoints)
        self.items = tuple(self._item(item) for item in items)

    def _item(self, item: Any) -> "AbstractRelation | AbstractConstraint":
        if isinstance(item, AbstractRelation):
            for name in item.signs:
                if name not in self.keypoints:
                    raise unknown("keypoint", name, self.keypoints)
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

    def __call__(self, x: Float[Array, "dim"], parameters: dict[str, Any] | None = None) -> Float[Array, "n"]:
        """Φ(x), the items' values one after another."""
        parameters = parameters or {}
        values = [x[:0]]
        for related, items in itertools.groupby(self.items, lambda item: isinstance(item, AbstractRelation)):
            if related:
                values.append(self._relations(list(items), x, parameters))
            else:
                values += [item(x, parameters) for item in items]
        return jnp.concatenate(values)

    def _relations(self, relations: list[AbstractRelation], x: Array, parameters: dict[str, Any]) -> Array:
        """All of them at once: Φ = (s y + n)·y with y = signs · x − p."""
        signs = np.array([[relation.signs.get(name, 0.0) for name in self.keypoints] for relation in relations])
        normals = [relation.normal for relation in relations]
        square = np.array([[0.0 if normal else 1.0] * 2 for normal in normals])
        linear = np.array([normal or (0.0, 0.0) for normal in normals])
        origins = [jnp.asarray(relation.origin(parameters), x.dtype) for relation in relations]
        points = x.reshape(1, -1, 2)
        y = jnp.sum(jnp.asarray(signs, x.dtype)[:, :, None] * points, axis=1) - jnp.stack(origins)
        return jnp.sum((jnp.asarray(square, x.dtype) * y + jnp.asarray(linear, x.dtype)) * y, axis=1)


def as_constraint(constraint: Any, dimension: int) -> AbstractConstraint:
    """The constraint itself, or a plain function made into one.

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
