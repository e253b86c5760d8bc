import numpy as np
import pytest

from keycld.evaluation import constraint_drift, energy_drift


def test_a_level_total_has_no_drift_whatever_the_zero_of_v():
    phase = np.linspace(0, 6, 50)[None]
    kinetic, potential = 3.0 * np.sin(phase) ** 2, 3.0 * np.cos(phase) ** 2 - 100.0
    scores, drift = energy_drift(kinetic, potential)
    assert scores["worst"] < 1e-12 and drift.shape == (1, 50)


def test_drift_is_relative_to_the_energy_that_moves():
    """Scaling mass and energy by a factor, which no video can tell, must not change the score."""
    rng = np.random.default_rng(0)
    kinetic, potential = rng.uniform(0, 1, (4, 30)), rng.uniform(0, 1, (4, 30))
    one, two = energy_drift(kinetic, potential)[0], energy_drift(7 * kinetic, 7 * potential)[0]
    assert two["mean"] == pytest.approx(one["mean"]) and two["scale"] == pytest.approx(7 * one["scale"])
    lost = energy_drift(np.array([[2.0, 1.0]]), np.array([[0.0, 0.5]]))[0]
    assert lost["worst"] == pytest.approx(0.25)


def test_constraint_drift_takes_the_largest_of_each_roll_out():
    assert constraint_drift(np.array([[0.0, 0.1], [0.3, 0.0]])) == {"mean": pytest.approx(0.2), "worst": 0.3}


def test_a_kinetic_energy_that_is_negative_scales_by_its_size():
    """As a learned T may be: the drift stays a share of the energy that moves."""
    kinetic = np.array([[-2.0, -1.0, -2.0]])
    scores, drift = energy_drift(kinetic, np.array([[2.0, 1.0, 2.2]]))
    assert scores["scale"] == 2.0
    np.testing.assert_allclose(drift, [[0.0, 0.0, 0.1]], atol=1e-12)
