"""Controllers: from an estimated motion to an input."""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from keycld.mechanics import State


class Belief(eqx.Module):
    """Estimate of the motion of one copy of the system.

    Attributes:
        state: positions and velocities in image-plane units and units/s, and the constants of the constraints.
        unmodelled: [2K], an observed acceleration that the learned dynamics lack, units/s².
        observations: number of frames observed so far.
        missed: number of frames that did not arrive since the last observation.
    """

    state: State
    unmodelled: Float[Array, "dim"]
    observations: Int[Array, ""]
    missed: Int[Array, ""] = eqx.field(default_factory=lambda: jnp.zeros((), jnp.int32))


class AbstractController(eqx.Module):
    """Maps the estimated motion to an input, for **one** copy of the system.

    `initial_memory` and `act` are pure functions of arrays: they are compiled into one program with the state
    estimator. `replan` may do slow work between two frames.
    """

    @abc.abstractmethod
    def initial_memory(self) -> Any:
        """Return the memory before the first frame: a pytree of arrays, or None."""

    @abc.abstractmethod
    def act(self, belief: Belief, memory: Any) -> tuple[Float[Array, "l"], Any]:
        """Return the input u until the next frame, and the memory after it."""

    def replan(self, beliefs: Belief, memories: Any, held: Float[np.ndarray, "n l"]) -> Any:
        """Return the memories of several copies (leading axis), with new plans where they are needed.

        Args:
            beliefs: at the present frame.
            memories: after `act`.
            held: the inputs that were just chosen.
        """
        return memories


def spread(u: Float[Array, "a"], actuators: tuple[int, ...], inputs: int) -> Float[Array, "l"]:
    """Return all inputs [l] from those that act [a]; the others are zero."""
    return jnp.zeros(inputs, u.dtype).at[jnp.asarray(actuators)].set(u)
