"""Holonomic constraints on named keypoints, and their composition into Φ(x)."""

import abc
from collections.abc import Callable, Mapping
from numbers import Real
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld._errors import KeycldError, unknown

Parameters = Mapping[str, Array]


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


class AbstractRelation(eqx.Module):
    """One scalar constraint between keypoints that are known by name."""

    @property
    @abc.abstractmethod
    def names(self) -> tuple[str, ...]:
        """The keypoints it speaks of."""

    @abc.abstractmethod
    def value(self, points: dict[str, Array], parameters: dict[str, Any]) -> Float[Array, ""]:
        """Its value, from the position [2] of every keypoint."""


class FixedDistance(AbstractRelation):
    """Two keypoints on one rigid body: Φ = |xᵢ − xⱼ|².

    The square keeps Φ a polynomial: its derivatives exist where the points meet.

    Args:
        first: name of one keypoint.
        second: name of another.

    Raises:
        KeycldError: if the two are the same.
    """

    first: str = eqx.field(static=True)
    second: str = eqx.field(static=True)

    def __check_init__(self):
        """A keypoint has no distance to itself."""
        if self.first == self.second:
            raise KeycldError(
                f"a fixed distance needs two different keypoints, but both are '{self.first}': name the other end."
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Both ends."""
        return (self.first, self.second)

    def value(self, points: dict[str, Array], parameters: dict[str, Any]) -> Float[Array, ""]:
        """|xᵢ − xⱼ|²."""
        return _square(points[self.first] - points[self.second])


class DistanceToPoint(AbstractRelation):
    """A keypoint that turns around a fixed point: Φ = |xᵢ − p|².

    Args:
        keypoint: its name.
        point: p, image-plane units; or the name of an entry [2] of the state's parameters, for a pivot that
            differs between trajectories. The image centre unless told.
    """

    keypoint: str = eqx.field(static=True)
    point: tuple[float, float] | str = eqx.field(static=True, default=(0.0, 0.0), converter=lambda p: _point(p))

    @property
    def names(self) -> tuple[str, ...]:
        """The one keypoint."""
        return (self.keypoint,)

    def value(self, points: dict[str, Array], parameters: dict[str, Any]) -> Float[Array, ""]:
        """|xᵢ − p|²."""
        x = points[self.keypoint]
        if isinstance(self.point, tuple):
            return _square(x - jnp.asarray(self.point, x.dtype))
        if self.point not in parameters:
            there = ", ".join(sorted(parameters)) or "none"
            raise KeycldError(
                f"'{self.keypoint}' turns around the parameter '{self.point}', which the state does not hold: "
                f"add it to the state's parameters (there: {there})."
            )
        return _square(x - parameters[self.point])


class OnLine(AbstractRelation):
    """A keypoint that slides along a straight line: Φ = n·xᵢ with the unit normal n of the line.

    Args:
        keypoint: its name.
        direction: of the line, any length; (1, 0) is horizontal.

    Raises:
        KeycldError: if the direction is zero or not finite.
    """

    keypoint: str = eqx.field(static=True)
    direction: tuple[float, float] = eqx.field(
        static=True, default=(1.0, 0.0), converter=lambda d: _pair("direction", d)
    )

    def __check_init__(self):
        """A line has a direction."""
        if self.direction == (0.0, 0.0):
            raise KeycldError(
                f"the line of '{self.keypoint}' has the direction (0, 0): give a direction such as (1, 0)."
            )

    @property
    def names(self) -> tuple[str, ...]:
        """The one keypoint."""
        return (self.keypoint,)

    def value(self, points: dict[str, Array], parameters: dict[str, Any]) -> Float[Array, ""]:
        """n·xᵢ."""
        dx, dy = self.direction
        length = (dx * dx + dy * dy) ** 0.5
        x = points[self.keypoint]
        return (dx / length) * x[1] - (dy / length) * x[0]


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
            for name in item.names:
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
        points = {name: x[2 * k : 2 * k + 2] for k, name in enumerate(self.keypoints)}
        values = [
            item.value(points, parameters)[None] if isinstance(item, AbstractRelation) else item(x, parameters)
            for item in self.items
        ]
        return jnp.concatenate([x[:0], *values])


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


def _square(d: Float[Array, "2"]) -> Float[Array, ""]:
    return d[0] * d[0] + d[1] * d[1]


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


def _pair(what: str, value: Any) -> tuple[float, float]:
    try:
        pair = tuple(value)
    except TypeError:
        pair = ()
    if len(pair) != 2 or not all(isinstance(p, Real) and abs(float(p)) < float("inf") for p in pair):
        raise KeycldError(f"a {what} is two finite numbers (x, y), not {value!r}.")
    return float(pair[0]), float(pair[1])


def _point(value: Any) -> tuple[float, float] | str:
    if isinstance(value, str):
        if not value.strip():
            raise KeycldError("the name of a point's parameter is empty: name it, or give two numbers.")
        return value
    return _pair("point", value)
