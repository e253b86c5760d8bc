"""A potential energy of any form."""

import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics.constraints import AbstractConstraint
from keycld.mechanics.force import AbstractPotentialTerm, register_term
from keycld.mechanics.networks import Perceptron


@register_term
class PerceptronPotential(AbstractPotentialTerm):
    """V by a perceptron 2K-16-16-1: the last resort, because it says nothing where no training motion was.

    Attributes:
        perceptron: near zero before training.
    """

    kind = "perceptron"
    meaning = "a potential energy of free form"
    tried = False
    width: ClassVar[int] = 16

    perceptron: Perceptron

    @classmethod
    def zero(cls, constraint: AbstractConstraint, *, key: PRNGKeyArray) -> "PerceptronPotential":
        """Return V = 0, but with hidden units that are not zero: least squares can begin."""
        perceptron = Perceptron((constraint.dimension, cls.width, cls.width, 1), key)
        *hidden, last = perceptron.kernels
        scaled = [kernel / (0.01 * math.sqrt(kernel.shape[0])) for kernel in hidden]
        return cls(eqx.tree_at(lambda p: p.kernels, perceptron, (*scaled, jnp.zeros_like(last))))

    def __call__(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return the perceptron's value."""
        return self.perceptron(x)[0]


@register_term
class WidePerceptronPotential(PerceptronPotential):
    """V by a perceptron 2K-32-32-1, that of models from before forces were identified."""

    kind = "perceptron-32"
    width = 32
