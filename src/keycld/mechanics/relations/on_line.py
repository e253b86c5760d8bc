"""A keypoint that slides along a straight line."""

from typing import Any

import equinox as eqx

from keycld._errors import KeycldError
from keycld.mechanics.relation import AbstractDisplacement, keypoint_entry, pair, register_relation


def _direction(value: Any) -> tuple[float, float]:
    return pair("direction", value)


@register_relation
class OnLine(AbstractDisplacement):
    """A keypoint that slides along a straight line: Φ = n·xᵢ with the unit normal n of the line (paper, Fig. 7).

    Args:
        keypoint: its name.
        direction: of the line, any length; (1, 0), the default, is horizontal.

    Raises:
        KeycldError: if the direction is zero or not finite.
    """

    kind = "on_line"
    required = ("keypoint",)
    optional = ("direction",)

    keypoint: str = eqx.field(static=True)
    direction: tuple[float, float] = eqx.field(static=True, default=(1.0, 0.0), converter=_direction)

    def __check_init__(self):
        """Refuse a line without a direction."""
        if self.direction == (0.0, 0.0):
            raise KeycldError(
                f"the line of '{self.keypoint}' has the direction (0, 0): give a direction such as (1, 0)."
            )

    @property
    def signs(self) -> dict[str, float]:
        """The one keypoint."""
        return {self.keypoint: 1.0}

    @property
    def normal(self) -> tuple[float, float]:
        """The direction turned by a right angle, of length one."""
        dx, dy = self.direction
        length = (dx * dx + dy * dy) ** 0.5
        return (-dy / length, dx / length)

    def origin(self, parameters: dict[str, Any]) -> tuple[float, float]:
        """Return zero: where the line lies is a constant of Φ."""
        return (0.0, 0.0)

    @classmethod
    def read(cls, entries: dict[str, Any]) -> "OnLine":
        """Return the relation from `keypoint` and `direction`, two numbers."""
        return cls(keypoint_entry(entries["keypoint"]), entries.get("direction", (1.0, 0.0)))

    def write(self) -> dict[str, Any]:
        """Return `keypoint` and `direction`."""
        return {"keypoint": self.keypoint, "direction": self.direction}
