"""How well a motion is followed and predicted, for a disc pendulum whose law is known."""

import numpy as np
import pytest

from keycld import KeycldError
from keycld.data import DataSet, write
from keycld.evaluation import evaluate_motion, load_evaluation, save_evaluation
from keycld.evaluation.motion import _beside, polynomial, valid_frames
from scenes import disc_pendulum
from swing import RADIUS, Still, Swing


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """One recording in each part, as of a clip; the first recording of a seed has no torque."""
    folder = tmp_path_factory.mktemp("clip")
    for seed, (split, frames) in enumerate({"train": 40, "validation": 12, "test": 30}.items(), start=3):
        write(folder / f"{split}.h5", disc_pendulum(1, frames, seed=seed))
    return DataSet(folder, None)


@pytest.fixture(scope="module")
def right(clip):
    return evaluate_motion(Swing.right(), clip, given=4)


def test_the_right_law_is_better_than_polynomials_and_than_a_wrong_one(clip, right):
    scores = right.scores
    assert scores["size"] == pytest.approx(RADIUS, rel=0.05)
    assert scores["error"]["rms"] < 0.25 * scores["baselines"]["constant acceleration"]["error"]["rms"]
    wrong = evaluate_motion(Swing.right(gravity=2.0), clip, given=4).scores
    assert scores["error"]["rms"] < 0.5 * wrong["error"]["rms"]
    assert scores["valid"]["0.1"] > scores["baselines"]["constant velocity"]["valid"]["0.1"]


def test_the_skeleton_is_the_circle_that_the_disc_moves_on(right):
    assert list(right.scores["skeleton"]) == ["pivot–disc"]
    assert right.scores["skeleton"]["pivot–disc"]["residual"] < 0.03
    assert right.scores["links"] == [{"label": "pivot–disc", "keypoints": ["disc"], "point": [0.0, 0.0]}]


def test_energy_and_angle_of_the_observed_motion(right):
    """Without torque and friction the energy stays; the angle is that of the simulation, from hanging down."""
    total = right.arrays["observed_kinetic"] + right.arrays["observed_potential"]
    assert np.std(total) < 0.1 * np.max(right.arrays["observed_kinetic"])
    angle, rate = right.arrays["observed_course"][:, 0].T
    truth = disc_pendulum(1, 30, seed=5).state[0]
    turns = 2 * np.pi * np.round((truth[0, 0] - angle[0]) / (2 * np.pi))
    np.testing.assert_allclose(angle + turns, truth[:, 0], atol=0.1)
    assert np.corrcoef(rate, truth[:, 1])[0, 1] > 0.99


def test_predicted_angles_begin_beside_the_observed_ones():
    """On both sides of straight up; the rates stay."""
    observed = np.array([[[3.1, 0.5]], [[3.2, 0.5]]])
    predicted = np.array([[[-3.1, 0.6]], [[-3.0, 0.6]]])
    shifted = _beside(Swing.right(), predicted, observed)
    np.testing.assert_allclose(shifted, predicted + [2 * np.pi, 0.0])


def test_what_is_stored_is_read_back_and_checked(tmp_path, right):
    save_evaluation(tmp_path, "motion", right)
    again = load_evaluation(tmp_path, "motion")
    assert again.scores == right.scores
    np.testing.assert_array_equal(again.arrays["predicted"], right.arrays["predicted"])
    damaged = {**right.arrays, "observed": right.arrays["observed"][:-1]}
    save_evaluation(tmp_path, "motion", type(right)(right.scores, damaged))
    with pytest.raises(KeycldError, match="damaged"):
        load_evaluation(tmp_path, "motion")


def test_polynomials_continue_parabolas_exactly():
    time = np.arange(20.0)
    path = np.stack([0.3 - 0.02 * time + 0.004 * time**2, 0.1 * time], -1)[None, :, None]
    np.testing.assert_allclose(polynomial(path[:, :5], 20, 2), path, atol=1e-9)
    off = np.linalg.norm(polynomial(path[:, :5], 20, 1) - path, axis=-1)[..., 0]
    assert off[0, -1] > 0.5
    assert valid_frames(np.array([[0.0, 0.0, 0.01, 0.05, 0.2], [0.0] * 5]), 2) == {"0.03": 2.0, "0.1": 2.5}


def test_models_without_keypoints_and_short_recordings_are_refused(clip):
    with pytest.raises(KeycldError, match="keypoints and energies"):
        evaluate_motion(Still(), clip)
    with pytest.raises(KeycldError, match="leave nothing to predict after 30"):
        evaluate_motion(Swing.right(), clip, given=30)
