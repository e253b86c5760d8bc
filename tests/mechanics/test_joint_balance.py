"""Predictions of a chain in its joints, and their standard errors."""

import numpy as np

from keycld.mechanics import FittedJointLaw, Joint, predict_joints

DT, GIVEN, NOISE = 0.05, 10, 1e-3


def test_errors_of_the_first_position_and_velocity_are_not_independent():
    """A free mass goes on along the cubic's tangent, so x + v t is a weighted sum of the given samples."""
    free = FittedJointLaw(np.array([1.0, 0, 0, 0, 0]), np.zeros((5, 5)), np.zeros(1), np.array([NOISE]))
    joints, time = (Joint(0, None, True, (1.0, 0.0)),), DT * np.arange(60)
    found = predict_joints(free, joints, (0.0,), 0.2 + 0.3 * time[:GIVEN, None], np.zeros((60, 1)), DT)
    np.testing.assert_allclose(found.q[:, 0], 0.2 + 0.3 * time, atol=1e-9)

    place, rate, *_ = np.linalg.pinv(np.vander(time[:GIVEN], 4, increasing=True))
    sums = place[None] + time[:, None] * rate[None]
    np.testing.assert_allclose(found.sigma[:, 0], NOISE * np.linalg.norm(sums, axis=1), rtol=1e-6)
