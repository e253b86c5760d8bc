"""Closed loops of links with one degree of freedom."""

import abc
from typing import Any, NamedTuple

import numpy as np

from keycld.systems.zoo.base import AbstractZooSystem


class Joints(NamedTuple):
    """The joints of an opened loop as functions of the crank's angle θ, all `[n]`.

    Attributes:
        position: J(θ), radians.
        slope: dJ/dθ.
        curvature: d²J/dθ², 1/rad.
    """

    position: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray


class AbstractLoop(AbstractZooSystem):
    """A linkage whose joints all follow from the angle of its crank; the loop is closed exactly.

    MuJoCo's model is the loop cut open, with joints j, M(j) j̈ = f(j, j̇) without the cut's reaction. With j = J(θ) the
    reaction does no work, so (J'ᵀ M J') θ̈ = J'ᵀ (f − M J'' θ̇²).
    """

    @abc.abstractmethod
    def follow(self, angle: float) -> Joints:
        """Return the joints that belong to the angle of the crank, radians."""

    def joints(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return J(θ) and J'(θ) θ̇."""
        position, slope, _ = self.follow(q[0])
        return position, slope * v

    def acceleration(self, mujoco: Any, model: Any, data: Any, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return θ̈ `[1]` from the accelerations of the open chain, M⁻¹ f."""
        mujoco.mj_forward(model, data)
        _, slope, curvature = self.follow(q[0])
        weighted = np.empty_like(slope)
        mujoco.mj_mulM(model, data, weighted, slope)
        return np.array([weighted @ (data.qacc - curvature * v[0] ** 2) / (weighted @ slope)])
