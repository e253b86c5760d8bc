import numpy as np
import pytest

from keycld import systems
from keycld.evaluation import fit_probe, invert_landmarks


def states(system, count, rng):
    m = len(system.state_names) // 2
    angles = np.array([unit == "rad" for unit in system.units[:m]])
    q = np.where(angles, rng.uniform(-np.pi, np.pi, (count, m)), rng.uniform(-1, 1, (count, m)))
    return np.concatenate([q, rng.standard_normal((count, m))], axis=1), angles


@pytest.mark.parametrize("name", ["pendulum", "cartpole", "acrobot"])
def test_landmarks_tell_the_configuration(name, rng):
    system = systems.get(name)
    guesses, angles = states(system, 500, rng)
    state, _ = states(system, 40, rng)
    q = invert_landmarks(system, system.landmarks(state), guesses)
    gap = q - state[:, : q.shape[1]]
    gap = np.where(angles, (gap + np.pi) % (2 * np.pi) - np.pi, gap)
    np.testing.assert_allclose(gap, 0.0, atol=1e-5)


@pytest.mark.parametrize("name", ["pendulum", "cartpole", "acrobot"])
def test_keypoints_that_are_an_affine_view_of_the_landmarks_have_no_error(name, rng):
    """Any placement on the parts will do: the probe undoes scale, rotation, shift and mixing."""
    system = systems.get(name)
    state, angles = states(system, 300, rng)
    count = len(system.keypoints)
    mixing, shift = rng.standard_normal((2 * count, 2 * count)), rng.standard_normal(2 * count)

    def observed(state):
        return (system.landmarks(state).reshape(len(state), -1) @ mixing + shift).reshape(len(state), count, 2)

    probe = fit_probe(system, observed(state), state, state, angles)
    fresh, _ = states(system, 50, rng)
    assert probe.landmark_errors(observed(fresh), fresh).max() < 1e-8
    assert probe.coordinate_errors(observed(fresh), fresh).max() < 1e-4


def test_an_error_of_the_angle_is_reported_in_degrees_modulo_a_turn(rng):
    system = systems.get("pendulum")
    state, angles = states(system, 300, rng)
    probe = fit_probe(system, system.landmarks(state), state, state, angles)
    turned = state + np.array([np.radians(350.0), 0.0])
    np.testing.assert_allclose(probe.coordinate_errors(system.landmarks(turned), state)[:, 0], 10.0, atol=1e-3)


def test_diverged_keypoints_stay_not_a_number(rng):
    system = systems.get("pendulum")
    state, angles = states(system, 50, rng)
    probe = fit_probe(system, system.landmarks(state), state, state, angles)
    keypoints = system.landmarks(state[:2])
    keypoints[1] = np.nan
    errors = probe.coordinate_errors(keypoints, state[:2])
    assert np.isfinite(errors[0, 0]) and np.isnan(errors[1, 0])
