"""What energy-shaping controllers share: the potential energy V is replaced by V_d with its minimum at the goal."""

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.control.base import AbstractController
from keycld.mechanics import ConstrainedLagrangian, matmul


class Energies(NamedTuple):
    """Energies and power of a motion, in the model's own unit of energy (and per second).

    Attributes:
        kinetic: T = ½ vᵀMv.
        potential: V(x).
        desired: V_d(x).
        power: uᵀgᵀv, of the inputs.
    """

    kinetic: Float[Array, "..."]
    potential: Float[Array, "..."]
    desired: Float[Array, "..."]
    power: Float[Array, "..."]


class AbstractShaping(AbstractController):
    """Replaces V by a bowl around the goal, and damps.

    Attributes:
        law: masses, potential energy, input matrix, constraints.
        goal: x* [2K], image-plane units.
        actuators: positions of the inputs that act; the others stay zero.
        kp: stiffness.
        kd: damping.
    """

    law: eqx.AbstractVar[ConstrainedLagrangian]
    goal: eqx.AbstractVar[Float[Array, "dim"]]
    actuators: eqx.AbstractVar[tuple[int, ...]]
    kp: eqx.AbstractVar[float]
    kd: eqx.AbstractVar[float]

    @abc.abstractmethod
    def desired_energy(self, x: Float[Array, "dim"]) -> Float[Array, ""]:
        """Return V_d(x), in the model's unit of energy."""

    def initial_memory(self) -> None:
        """Return None: there is nothing to remember."""

    def energies(self, x: Float[Array, "dim"], v: Float[Array, "dim"], u: Float[Array, "l"]) -> Energies:
        """Return T, V, V_d and the input power of one motion; the loop is passive where T + V_d never rises."""
        power = jnp.sum(u * matmul(input_matrix(self.law, x).T, v))
        return Energies(self.law.kinetic_energy(x, v), self.law.potential_energy(x), self.desired_energy(x), power)


def input_matrix(law: ConstrainedLagrangian, x: Float[Array, "dim"]) -> Float[Array, "dim l"]:
    """Return g(x).

    Raises:
        KeycldError: the law of motion has no input.
    """
    if law.input_matrix is None:
        raise KeycldError("energy shaping needs an input, and this law of motion has none: train on data with inputs.")
    return law.input_matrix(x)
