"""Two keypoints on one rigid body."""

from typing import Any

import equinox as eqx

from keycld._errors import KeycldError
from keycld.mechanics.relation import AbstractDisplacement, register_relation


@register_relation
class FixedDistance(AbstractDisplacement):
    """Two keypoints on one rigid body: Φ = |xᵢ − xⱼ|² (paper, Fig. 7).

    The square keeps Φ a polynomial: its derivatives exist where the points meet.

    Args:
        first: name of one keypoint.
        second: name of another.

    Raises:
        KeycldError: if the two are the same.
    """

    kind = "fixed_distance"
    required = ("between",)

    first: str = eqx.field(static=True)
    second: str = eqx.field(static=True)

    def __check_init__(self):
        """Refuse the distance of a keypoint to itself."""
        if self.first == self.second:
            raise KeycldError(
                f"a fixed distance needs two different keypoints, but both are '{self.first}': name the other end."
            )

    @property
    def signs(self) -> dict[str, float]:
        """First minus second."""
        return {self.first: 1.0, self.second: -1.0}

    @property
    def normal(self) -> None:
        """None: Φ is a square."""

    def origin(self, parameters: dict[str, Any]) -> tuple[float, float]:
        """Return zero."""
        return (0.0, 0.0)

    @classmethod
    def read(cls, entries: dict[str, Any]) -> "FixedDistance":
        """Return the relation from `between`, two names."""
        between = entries["between"]
        if not isinstance(between, list) or len(between) != 2 or not all(isinstance(name, str) for name in between):
            raise KeycldError(f'\'between\' is two keypoints such as ["cart", "tip"], not {between!r}.')
        return cls(*between)

    def write(self) -> dict[str, Any]:
        """Return `between`."""
        return {"between": (self.first, self.second)}
