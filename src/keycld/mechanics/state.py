"""What evolves and what stays: the state of a system, and the interfaces of what moves it."""

import abc
from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, Float, PyTree

Scalar = float | int | Float[Array, ""]
"""A number: a Python one, or an array without axes."""


RESERVED = ("constants", "place", "masses", "friction", "looks")
"""Names in the parameters of a state that have a meaning of their own."""


class Motion(NamedTuple):
    """Positions and velocities of a mechanical system at one instant.

    Attributes:
        x: keypoint positions, flattened (x1, y1, x2, y2, …), image-plane units; or generalised coordinates.
        v: their rates of change, units per second.
    """

    x: Float[Array, "dim"]
    v: Float[Array, "dim"]


class PhasePoint(NamedTuple):
    """A point of phase space.

    Attributes:
        q: generalised coordinates.
        p: momenta conjugate to them.
    """

    q: Float[Array, "m"]
    p: Float[Array, "m"]


class State(eqx.Module):
    """A state: `coordinates` evolve, `parameters` are constant along a trajectory.

    Attributes:
        coordinates: any pytree of arrays; laws of second order use a `Motion`, Hamiltonians a `PhasePoint`.
        parameters: arrays by name. RATTLE and SHAKE read `constants`, the values Φ [n] that the constraints
            keep; a constraint may read others, such as a pivot that differs between trajectories.
    """

    coordinates: PyTree
    parameters: dict[str, Array]


class AbstractField(eqx.Module):
    """An autonomous differential equation of first order, ds/dt = F(s, u)."""

    @abc.abstractmethod
    def derivative(self, coordinates: PyTree, u: Float[Array, "l"], parameters: dict[str, Any] | None = None) -> PyTree:
        """Return F(s, u), a pytree like `coordinates`.

        Args:
            coordinates: s, a pytree of arrays.
            u: the input [l].
            parameters: those of the trajectory's state.
        """


class AbstractDynamics(eqx.Module):
    """Anything that carries a state to the next frame."""

    @abc.abstractmethod
    def step(self, state: State, u: Float[Array, "l"], dt: Scalar) -> State:
        """Return the state one frame of `dt` seconds later, with the input `u` held; `dt` may be negative."""
