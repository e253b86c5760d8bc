"""What a stage minimises."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float, Int, PRNGKeyArray

from keycld.data import Clip

Terms = dict[str, Float[Array, ""]]


class AbstractLoss(eqx.Module):
    """A scalar to minimise and its terms by name, for a batch of clips; the loss itself applies `vmap`."""

    @abstractmethod
    def __call__(
        self, model: Any, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluate the loss; `key` and `step` are the randomness and the number of the stage's step."""


class AbstractStatefulLoss(eqx.Module):
    """A loss with a state of its own that no gradient trains, such as the multiplier of GECO.

    The state belongs to the stage: it starts anew with it, is part of every checkpoint, and changes at every step.
    """

    @abstractmethod
    def initial(self) -> Any:
        """Return the state at the stage's first step, a pytree of arrays."""

    @abstractmethod
    def __call__(
        self, model: Any, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""], memory: Any
    ) -> tuple[Float[Array, ""], Terms, Any]:
        """Evaluate the loss with the state `memory`; return the scalar, its terms and the next state."""
