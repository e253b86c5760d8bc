"""Rigid bodies of the plane as point masses, and back (paper, appendix A.3)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from keycld._errors import KeycldError


class RigidBody(NamedTuple):
    """A body of the plane.

    Attributes:
        mass: m.
        inertia: I about the centre of mass, mass · length².
        centre: x_c [2], the centre of mass.
    """

    mass: float
    inertia: float
    centre: Float[np.ndarray, "2"]


class PointPair(NamedTuple):
    """Two rigidly connected point masses.

    Attributes:
        masses: m₁, m₂ [2].
        points: x₁, x₂ [2, 2].
    """

    masses: Float[np.ndarray, "2"]
    points: Float[np.ndarray, "2 2"]


def two_point_masses(body: RigidBody, first: Float[np.ndarray, "2"]) -> PointPair:
    """Compute the two point masses that move like a rigid body, one of them at a point of your choice.

    Eq. (28) has four equations for six unknowns. The position of the first point, at distance r₁ from the
    centre, fixes the two that are free; the second lies on the other side at r₂ = I/(m r₁) (the centre of
    percussion), and m₁ = m r₂/(r₁ + r₂), m₂ = m r₁/(r₁ + r₂). Put the first one at the pivot.

    Args:
        body: mass, inertia and centre, in any consistent units.
        first: x₁ [2], anywhere but at the centre.

    Raises:
        KeycldError: if mass or inertia is not positive, or `first` is the centre.
    """
    centre, first = np.asarray(body.centre, np.float64), np.asarray(first, np.float64)
    if not (body.mass > 0 and body.inertia > 0):
        raise KeycldError(
            f"a rigid body has a positive mass and inertia, not {body.mass} and {body.inertia}: "
            "a body without inertia is one point mass."
        )
    arm = first - centre
    r1 = float(np.hypot(*arm))
    if not r1 > 0:
        raise KeycldError(
            f"the first point mass is at the centre of mass ({centre[0]}, {centre[1]}): choose another point."
        )
    r2 = body.inertia / (body.mass * r1)
    masses = body.mass / (r1 + r2) * np.array([r2, r1])
    return PointPair(masses, np.stack([first, centre - arm * (r2 / r1)]))


def rigid_body(masses: Float[np.ndarray, "K"], points: Float[np.ndarray, "K 2"]) -> RigidBody:
    """Compute the rigid body that K rigidly connected point masses form, by the sums of eq. (28).

    Args:
        masses: m [K], not negative, not all zero.
        points: their positions [K, 2].

    Raises:
        KeycldError: if a mass is negative or the sum is not positive.
    """
    masses, points = np.asarray(masses, np.float64), np.asarray(points, np.float64)
    mass = float(masses.sum())
    if not (mass > 0 and (masses >= 0).all()):
        raise KeycldError(f"point masses are not negative and have a positive sum, unlike {masses.tolist()}.")
    centre = masses @ points / mass
    return RigidBody(mass, float(masses @ ((points - centre[None, :]) ** 2).sum(axis=1)), centre)
