"""A law of motion without physics: the second-order neural differential equation."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics.lagrangian import AbstractLaw
from keycld.mechanics.networks import Perceptron


class SecondOrderNetwork(AbstractLaw):
    """a = perceptron(x, v, u) with three hidden layers: NODE2 of the paper's ablation (appendix A.4).

    It has neither energies nor constraints. The paper's layers have 64 units, CELU between them, and kernels from
    N(0, 0.01²) before training.

    Args:
        dim: number of coordinates, 2K.
        inputs: l.
        width: units of a hidden layer.
        key: for the kernels.
    """

    perceptron: Perceptron

    def __init__(self, dim: int, inputs: int, width: int = 64, *, key: PRNGKeyArray):
        self.perceptron = Perceptron((2 * dim + inputs, width, width, width, dim), key)

    @property
    def inputs(self) -> int:
        """l: what the first layer takes in addition to x and v, which are as long as a."""
        return self.perceptron.kernels[0].shape[0] - 2 * self.perceptron.biases[-1].shape[0]

    def acceleration(
        self,
        x: Float[Array, "dim"],
        v: Float[Array, "dim"],
        u: Float[Array, "l"],
        parameters: dict[str, Any] | None = None,
    ) -> Float[Array, "dim"]:
        """Return a(x, v, u); `parameters` are not used."""
        return self.perceptron(jnp.concatenate([x, v, u]))
