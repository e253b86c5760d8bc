"""From a frame to an input: observer and controller as one function to compile."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Shaped

from keycld.control.base import AbstractController, Belief
from keycld.control.observer import AbstractObserver
from keycld.models.base import AbstractModel


class Aboard(NamedTuple):
    """What a pilot remembers: the observer's belief and the controller's memory."""

    belief: Belief
    memory: Any


class Pilot(eqx.Module):
    """The model's eyes, an observer, a controller and the limit of the motors, for **one** copy of the system.

    Attributes:
        model: finds keypoints.
        observer: keypoints → motion.
        controller: motion → input.
        limit: the largest |u|; infinity for none.
    """

    model: AbstractModel
    observer: AbstractObserver
    controller: AbstractController
    limit: float

    def begin(self) -> Aboard:
        """Before the first frame."""
        return Aboard(self.observer.begin(), self.controller.begin())

    def __call__(
        self, aboard: Aboard, frame: Shaped[Array, "H W 3"], arrived: Bool[Array, ""], held: Float[Array, "l"]
    ) -> tuple[Aboard, Float[Array, "l"]]:
        """The input until the next frame.

        Args:
            aboard: after the last frame.
            frame: uint8, or float in [0, 1]; one with NaN or infinity counts as not arrived.
            arrived: whether there is a new frame; without one the motion is predicted.
            held: the input since the last frame.

        Returns:
            What to remember, and u, zero until something has been seen.
        """
        values = frame / 255.0 if frame.dtype == jnp.uint8 else frame
        arrived = arrived & jnp.all(jnp.isfinite(values))
        seen = self.model.observe(jnp.where(arrived, values, 0.0))
        assert seen is not None  # a model with a Lagrangian has keypoints
        belief = self.observer.update(aboard.belief, seen.keypoints.reshape(-1), arrived, held)
        u, memory = self.controller.act(belief, aboard.memory)
        u = jnp.where(belief.sightings > 0, jnp.clip(u, -self.limit, self.limit), 0.0)
        return Aboard(belief, memory), u
