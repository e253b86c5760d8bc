"""What evolves and what stays: the state of a system, and the interface of all that moves it."""

import abc
from typing import NamedTuple

import equinox as eqx
from jaxtyping import Array, Float, PyTree

Scalar = float | int | Float[Array, ""]
"""A number: a Python one, or an array without axes."""


class Motion(NamedTuple):
    """Positions and velocities of a mechanical system at one instant.

    Attributes:
        x: keypoint positions, flattened (x1, y1, x2, y2, …), image-plane units; or generalised coordinates.
        v: their rates of change, units per second.
    """

    x: Float[Array, "dim"]
    v: Float[Array, "dim"]


class State(eqx.Module):
    """A state: `coordinates` evolve, `parameters` are constant along a trajectory.

    Attributes:
        coordinates: any pytree of arrays; mechanical dynamics use a `Motion`.
        parameters: arrays by name. RATTLE and SHAKE read `constants`, the values Φ [n] that the constraints
            keep; a constraint may read others, as a pivot that differs between trajectories.
    """

    coordinates: PyTree
    parameters: dict[str, Array]


class AbstractDynamics(eqx.Module):
    """Anything that carries a state to the next frame."""

    @abc.abstractmethod
    def step(self, state: State, u: Float[Array, "l"], dt: Scalar) -> State:
        """The state one frame of `dt` seconds later, with the input `u` held; `dt` may be negative."""
