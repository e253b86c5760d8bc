"""A keypoint that turns around a fixed point."""

from typing import Any

import equinox as eqx

from keycld._errors import KeycldError
from keycld.mechanics.relation import AbstractDisplacement, keypoint_entry, pair, register_relation


def _point(value: Any) -> tuple[float, float] | str:
    if isinstance(value, str):
        if not value.strip():
            raise KeycldError("the name of a point's parameter is empty: name it, or give two numbers.")
        return value
    return pair("point", value)


@register_relation
class DistanceToPoint(AbstractDisplacement):
    """A keypoint that turns around a fixed point: Φ = |xᵢ − p|² (paper, Fig. 7).

    Args:
        keypoint: its name.
        point: p, image-plane units; or the name of an entry [2] of the state's parameters, for a pivot that
            differs between trajectories. By default the image centre.

    Raises:
        KeycldError: if the point is neither two finite numbers nor a name.
    """

    kind = "distance_to_point"
    required = ("keypoint",)
    optional = ("point",)

    keypoint: str = eqx.field(static=True)
    point: tuple[float, float] | str = eqx.field(static=True, default=(0.0, 0.0), converter=_point)

    @property
    def signs(self) -> dict[str, float]:
        """The one keypoint."""
        return {self.keypoint: 1.0}

    @property
    def normal(self) -> None:
        """None: Φ is a square."""

    def origin(self, parameters: dict[str, Any]) -> Any:
        """Return the point, or the entry of the parameters that it names.

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

    @classmethod
    def read(cls, entries: dict[str, Any]) -> "DistanceToPoint":
        """Return the relation from `keypoint` and `point`, two numbers or the name of a parameter."""
        return cls(keypoint_entry(entries["keypoint"]), entries.get("point", (0.0, 0.0)))

    def write(self) -> dict[str, Any]:
        """Return `keypoint` and `point`."""
        return {"keypoint": self.keypoint, "point": self.point}
