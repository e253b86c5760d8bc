"""A keypoint that turns around a fixed point."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics.circle import nearest_circle
from keycld.mechanics.relation import UNKNOWN, AbstractDisplacement, keypoint_entry, pair, register_relation
from keycld.mechanics.state import RESERVED


def _point(value: Any) -> tuple[float, float] | str:
    if isinstance(value, str):
        if not value.strip():
            raise KeycldError("the name of a point's parameter is empty: name it, or give two numbers.")
        if value in RESERVED:
            raise KeycldError(
                f"a point cannot be the parameter '{value}': {', '.join(RESERVED)} have a meaning of their own in a "
                "state, so choose another name."
            )
        return value
    return pair("point", value)


@register_relation
class DistanceToPoint(AbstractDisplacement):
    """A keypoint that turns around a fixed point: Φ = |xᵢ − p|² (paper, Fig. 7).

    Args:
        keypoint: its name.
        point: p, image-plane units; or "unknown", for a pivot that is learned and that all trajectories share; or the
            name of an entry [2] of the state's parameters, for a pivot that differs between trajectories. By default
            the image centre.

    Attributes:
        learned: p where it is unknown, image-plane units; it may be outside of the picture. The image centre before
            the first fit.

    Raises:
        KeycldError: if the point is neither two finite numbers nor a name, or the name has another meaning.
    """

    kind = "distance_to_point"
    required = ("keypoint",)
    optional = ("point",)

    keypoint: str = eqx.field(static=True)
    point: tuple[float, float] | str = eqx.field(static=True)
    learned: Float[Array, "2"] | None

    def __init__(self, keypoint: str, point: Any = (0.0, 0.0)):
        self.keypoint = keypoint
        self.point = _point(point)
        self.learned = jnp.zeros(2) if self.point == UNKNOWN else None

    @property
    def signs(self) -> dict[str, float]:
        """The one keypoint."""
        return {self.keypoint: 1.0}

    @property
    def normal(self) -> None:
        """None: Φ is a square."""

    def origin(self, parameters: dict[str, Any]) -> Any:
        """Return the point, the learned one, or the entry of the parameters that it names.

        Raises:
            KeycldError: if the parameters lack it.
        """
        if isinstance(self.point, tuple):
            return self.point
        if self.learned is not None:
            return self.learned
        if self.point not in parameters:
            there = ", ".join(sorted(parameters)) or "none"
            raise KeycldError(
                f"'{self.keypoint}' turns around the parameter '{self.point}', which the state does not hold (there: "
                f"{there}): add it in your own roll-outs; models that are trained know none by names of your own, so "
                f'give them a point of two numbers, or "{UNKNOWN}".'
            )
        return parameters[self.point]

    @property
    def unknowns(self) -> dict[str, Array]:
        """The pivot, if it is learned."""
        return {} if self.learned is None else {"pivot": self.learned}

    def located(self, points: Float[Array, "M 1 2"]) -> "DistanceToPoint":
        """Return the relation with an unknown pivot in the centre of the circle that is nearest to the positions."""
        if self.learned is None:
            return self
        return eqx.tree_at(lambda item: item.learned, self, nearest_circle(points[:, 0])[0])

    @classmethod
    def read(cls, entries: dict[str, Any]) -> "DistanceToPoint":
        """Return the relation from `keypoint` and `point`, two numbers, "unknown" or the name of a parameter."""
        return cls(keypoint_entry(entries["keypoint"]), entries.get("point", (0.0, 0.0)))

    def write(self) -> dict[str, Any]:
        """Return `keypoint` and `point`."""
        return {"keypoint": self.keypoint, "point": self.point}
