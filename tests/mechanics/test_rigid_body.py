"""Rigid bodies as point masses (appendix A.3), both ways."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from keycld import KeycldError
from keycld.mechanics import RigidBody, rigid_body, two_point_masses

positive = st.floats(0.01, 100)
coordinate = st.floats(-10, 10)


@given(mass=positive, inertia=positive, centre=st.tuples(coordinate, coordinate), r=positive, angle=coordinate)
def test_there_and_back(mass, inertia, centre, r, angle):
    body = RigidBody(mass, inertia, np.array(centre))
    first = body.centre + r * np.array([np.cos(angle), np.sin(angle)])
    pair = two_point_masses(body, first)
    np.testing.assert_allclose(pair.points[0], first)
    assert (pair.masses > 0).all()
    again = rigid_body(pair.masses, pair.points)
    np.testing.assert_allclose(again.mass, mass, rtol=1e-9)
    np.testing.assert_allclose(again.inertia, inertia, rtol=1e-6)
    np.testing.assert_allclose(again.centre, centre, atol=1e-6)


def test_kinetic_energy_of_a_rod():
    """A rod of mass 3 and length 2 (I = m l²/12) by its two point masses, in any motion, eq. (27)."""
    body = RigidBody(3.0, 1.0, np.array([0.5, 0.2]))
    pair = two_point_masses(body, np.array([-0.5, 0.2]))
    velocity, turn = np.array([0.7, -1.1]), 2.3
    arms = pair.points - body.centre
    speeds = velocity + turn * np.stack([-arms[:, 1], arms[:, 0]], axis=1)
    kinetic = 0.5 * np.sum(pair.masses * np.sum(speeds**2, axis=1))
    np.testing.assert_allclose(kinetic, 0.5 * 3.0 * velocity @ velocity + 0.5 * 1.0 * turn**2)
    # Seen from one end, the other mass sits at the centre of percussion, two thirds of the rod.
    np.testing.assert_allclose(pair.points[1], [-0.5 + 2 * 2 / 3, 0.2])


def test_mistakes():
    body = RigidBody(1.0, 0.1, np.zeros(2))
    with pytest.raises(KeycldError, match="at the centre of mass"):
        two_point_masses(body, np.zeros(2))
    with pytest.raises(KeycldError, match="positive mass and inertia"):
        two_point_masses(body._replace(inertia=0.0), np.ones(2))
    with pytest.raises(KeycldError, match="positive sum"):
        rigid_body(np.array([1.0, -0.5]), np.zeros((2, 2)))
