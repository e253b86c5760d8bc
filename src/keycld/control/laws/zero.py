"""No input, for comparison."""

from dataclasses import dataclass
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.control.base import AbstractController, Belief
from keycld.control.registry import AbstractControlLaw, Problem, register_law


class ZeroInput(AbstractController):
    """Gives u = 0.

    Attributes:
        inputs: l, how many there are.
    """

    inputs: int = eqx.field(static=True)

    def initial_memory(self) -> None:
        """Return None: there is nothing to remember."""

    def act(self, belief: Belief, memory: None) -> tuple[Float[Array, "l"], None]:
        """Return no input."""
        return jnp.zeros(self.inputs), None


@register_law
@dataclass(frozen=True)
class ZeroLaw(AbstractControlLaw):
    """No input: what the system does by itself; for comparison."""

    name: ClassVar[str] = "zero"

    def controller(self, problem: Problem) -> ZeroInput:
        """Return u = 0."""
        return ZeroInput(problem.law.inputs)
