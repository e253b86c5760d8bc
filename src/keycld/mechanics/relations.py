"""Holonomic constraints between keypoints that are known by name."""

import abc
from numbers import Real
from typing import Any

import equinox as eqx

from keycld._errors import KeycldError


class AbstractRelation(eqx.Module):
    """One scalar constraint on y = Σ ±xᵢ − p: the square |y|², or the component n·y along a normal.

    Every relation has this one form, so that `Constraints` evaluates all of them at once.
    """

    @property
    @abc.abstractmethod
    def signs(self) -> dict[str, float]:
        """The keypoints it speaks of, each with its sign in y."""

    @property
    def normal(self) -> tuple[float, float] | None:
        """n, or None for a square."""
        return None

    def origin(self, parameters: dict[str, Any]) -> Any:
        """P [2]."""
        return (0.0, 0.0)


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
    def signs(self) -> dict[str, float]:
        """First minus second."""
        return {self.first: 1.0, self.second: -1.0}


class DistanceToPoint(AbstractRelation):
    """A keypoint that turns around a fixed point: Φ = |xᵢ − p|².

    Args:
        keypoint: its name.
        point: p, image-plane units; or the name of an entry [2] of the state's parameters, for a pivot that
            differs between trajectories. The image centre unless told.

    Raises:
        KeycldError: if the point is neither two finite numbers nor a name.
    """

    keypoint: str = eqx.field(static=True)
    point: tuple[float, float] | str = eqx.field(static=True, default=(0.0, 0.0), converter=lambda point: _point(point))

    @property
    def signs(self) -> dict[str, float]:
        """The one keypoint."""
        return {self.keypoint: 1.0}

    def origin(self, parameters: dict[str, Any]) -> Any:
        """The point, or the entry of the parameters that it names.

        Raises:
            KeycldError: if the parameters lack it.
        """
        if isinstance(self.point, tuple):
            return self.point
        if self.point not in parameters:
            there = ", ".join(sorted(parameters)) or "none"
            raise KeycldError(
                f"'{self.keypoint}' turns around the parameter '{self.point}', which the state does not hold: "
                f"add it to the state's parameters (there: {there})."
            )
        return parameters[self.point]


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
        static=True, default=(1.0, 0.0), converter=lambda direction: _pair("direction", direction)
    )

    def __check_init__(self):
        """A line has a direction."""
        if self.direction == (0.0, 0.0):
            raise KeycldError(
                f"the line of '{self.keypoint}' has the direction (0, 0): give a direction such as (1, 0)."
            )

    @property
    def signs(self) -> dict[str, float]:
        """The one keypoint."""
        return {self.keypoint: 1.0}

    @property
    def normal(self) -> tuple[float, float] | None:
        """The direction turned by a right angle, of length one."""
        dx, dy = self.direction
        length = (dx * dx + dy * dy) ** 0.5
        return (-dy / length, dx / length)


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
