"""Interfaces of the losses that stages minimise."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float, Int, PRNGKeyArray

from keycld.data import Clip

Terms = dict[str, Float[Array, ""]]


class AbstractLoss(eqx.Module):
    """A scalar to minimise, and its terms by name, for a batch of clips; the loss itself applies `vmap`."""

    @abstractmethod
    def __call__(
        self, model: Any, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Return the loss and its terms.

        Args:
            model: with the parameters of this step.
            clips: a batch.
            key: for the randomness of this step.
            step: number of the step in its stage.
        """


class AbstractStatefulLoss(eqx.Module):
    """A loss with a state that no gradient trains, such as the multiplier of GECO.

    The state belongs to the stage: each stage has its own, which changes at every step. Checkpoints hold it.
    """

    @abstractmethod
    def initial(self) -> Any:
        """Return the state at the stage's first step, a pytree of arrays."""

    @abstractmethod
    def __call__(
        self, model: Any, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""], memory: Any
    ) -> tuple[Float[Array, ""], Terms, Any]:
        """Return the loss, its terms and the next state.

        Args:
            model: with the parameters of this step.
            clips: a batch.
            key: for the randomness of this step.
            step: number of the step in its stage.
            memory: the state.
        """
