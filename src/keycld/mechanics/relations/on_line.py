"""A keypoint that slides along a straight line."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics.relation import UNKNOWN, AbstractDisplacement, keypoint_entry, pair, register_relation


@register_relation
class OnLine(AbstractDisplacement):
    """A keypoint that slides along a straight line: Φ = n·xᵢ with the unit normal n of the line (paper, Fig. 7).

    Args:
        keypoint: its name.
        direction: of the line, any length; (1, 0), the default, is horizontal. Or "unknown", for a direction that is
            learned and that all trajectories share.

    Attributes:
        learned: the angle of an unknown direction against the horizontal, rad; zero before the first fit.

    Raises:
        KeycldError: if the direction is zero or not finite.
    """

    kind = "on_line"
    required = ("keypoint",)
    optional = ("direction",)

    keypoint: str = eqx.field(static=True)
    direction: tuple[float, float] | str = eqx.field(static=True)
    learned: Float[Array, ""] | None

    def __init__(self, keypoint: str, direction: Any = (1.0, 0.0)):
        self.keypoint = keypoint
        unknown = isinstance(direction, str) and direction == UNKNOWN
        self.direction = UNKNOWN if unknown else pair("direction", direction)
        self.learned = jnp.zeros(()) if unknown else None

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
    def normal(self) -> tuple[float, float] | Float[Array, "2"]:
        """The direction turned by a right angle, of length one."""
        if self.learned is not None:
            return jnp.stack([-jnp.sin(self.learned), jnp.cos(self.learned)])
        assert isinstance(self.direction, tuple)
        dx, dy = self.direction
        length = (dx * dx + dy * dy) ** 0.5
        return (-dy / length, dx / length)

    def origin(self, parameters: dict[str, Any]) -> tuple[float, float]:
        """Return zero: where the line lies is a constant of Φ."""
        return (0.0, 0.0)

    @property
    def unknowns(self) -> dict[str, Array]:
        """The angle of the direction, if it is learned."""
        return {} if self.learned is None else {"angle": self.learned}

    def located(self, points: Float[Array, "M 1 2"]) -> "OnLine":
        """Return the relation with an unknown direction along the longer axis of the positions' covariance."""
        if self.learned is None:
            return self
        x, y = (points[:, 0] - jnp.mean(points[:, 0], axis=0)[None, :]).T
        angle = 0.5 * jnp.arctan2(2 * jnp.sum(x * y), jnp.sum(x**2) - jnp.sum(y**2))
        return eqx.tree_at(lambda item: item.learned, self, angle)

    @classmethod
    def read(cls, entries: dict[str, Any]) -> "OnLine":
        """Return the relation from `keypoint` and `direction`, two numbers or "unknown"."""
        return cls(keypoint_entry(entries["keypoint"]), entries.get("direction", (1.0, 0.0)))

    def write(self) -> dict[str, Any]:
        """Return `keypoint` and `direction`."""
        return {"keypoint": self.keypoint, "direction": self.direction}
