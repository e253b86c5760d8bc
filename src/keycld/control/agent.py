"""From a frame to an input: keypoint estimator, state estimator and controller as one function to compile."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Shaped

from keycld.control.base import AbstractController, Belief
from keycld.control.state_estimator import AbstractStateEstimator
from keycld.models.base import HasKeypoints


class AgentState(NamedTuple):
    """Memory of an agent.

    Attributes:
        belief: of the state estimator.
        memory: of the controller.
    """

    belief: Belief
    memory: Any


class Agent(eqx.Module):
    """A model that observes keypoints, a state estimator, a controller and an input limit; for **one** system.

    Attributes:
        model: frame → keypoints.
        estimator: keypoints → motion.
        controller: motion → input.
        limit: the largest |u|; infinity for none.
    """

    model: HasKeypoints
    estimator: AbstractStateEstimator
    controller: AbstractController
    limit: float

    def initial_state(self) -> AgentState:
        """Return the memory before the first frame."""
        return AgentState(self.estimator.initial_belief(), self.controller.initial_memory())

    def __call__(
        self, state: AgentState, frame: Shaped[Array, "H W 3"], arrived: Bool[Array, ""], held: Float[Array, "l"]
    ) -> tuple[AgentState, Float[Array, "l"]]:
        """Return the memory after a frame, and the input until the next one.

        Args:
            state: after the last frame.
            frame: uint8, or float in [0, 1]; one with NaN or infinity counts as not arrived.
            arrived: whether there is a new frame; without one the motion is predicted.
            held: the input since the last frame.

        Returns:
            The memory, and u [l], which is zero until something has been observed.
        """
        values = frame / 255.0 if frame.dtype == jnp.uint8 else frame
        arrived = arrived & jnp.all(jnp.isfinite(values))
        observation = self.model.observe(jnp.where(arrived, values, 0.0))
        belief = self.estimator.update(state.belief, observation.keypoints.reshape(-1), arrived, held)
        u, memory = self.controller.act(belief, state.memory)
        u = jnp.where(belief.observations > 0, jnp.clip(u, -self.limit, self.limit), 0.0)
        return AgentState(belief, memory), u
