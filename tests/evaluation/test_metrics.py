from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from keycld import KeycldError
from keycld.evaluation import (
    DM_THRESHOLD,
    epsilon,
    frame_errors,
    mean_image,
    relative_errors,
    statistics,
    valid_prediction_time,
)

GOLDEN = sorted((Path(__file__).parent / "golden").glob("*.npz"))


@pytest.mark.parametrize("path", GOLDEN, ids=lambda path: path.stem)
def test_golden_cases(path):
    case = np.load(path)
    if str(case["definition"]) == "keycld":
        threshold, part = epsilon(case["gt"]), None
        assert threshold == pytest.approx(float(case["epsilon"]), rel=1e-5)
        errors = frame_errors(case["gt"], case["pred"])
    else:
        threshold, part = DM_THRESHOLD, tuple(int(k) for k in case["part"])
        assert threshold == float(case["threshold"])
        errors = relative_errors(case["gt"], case["pred"])
    finite = np.isfinite(case["error"])
    np.testing.assert_allclose(errors[finite], case["error"][finite], rtol=1e-5)
    frames = valid_prediction_time(errors, threshold, part=part)
    np.testing.assert_array_equal(frames, case["vpt_frames"])
    length = part[1] - part[0] if part else errors.shape[1]
    score = statistics(frames / length)
    for name in ("mean", "std", "median"):
        assert score[name] == pytest.approx(float(case[f"vpt_normalised_{name}"]), abs=1e-12)


def test_there_are_golden_cases_of_both_definitions():
    assert {path.stem.split("_")[0] for path in GOLDEN} == {"keycld", "dm"}


def test_epsilon_is_the_error_of_the_best_still_picture(rng):
    images = rng.integers(0, 256, (3, 300, 4, 5, 3)).astype(np.uint8)
    exact = images.astype(np.float64) / 255.0
    assert epsilon(images) == pytest.approx(np.mean((exact - exact.mean(axis=(0, 1))) ** 2), rel=1e-12)
    still = np.broadcast_to(mean_image(images), images.shape)
    assert frame_errors(images, still).mean() == pytest.approx(epsilon(images), rel=1e-5)
    shifted = np.clip(still + 0.01, 0, 1)
    assert frame_errors(images, shifted).mean() > epsilon(images)


def test_bytes_and_floats_mean_the_same(rng):
    truth, other = rng.integers(0, 256, (2, 2, 4, 3, 3, 3)).astype(np.uint8)
    np.testing.assert_allclose(
        frame_errors(truth, other), frame_errors(truth / np.float32(255), other / np.float32(255)), rtol=1e-5
    )


def test_equality_is_not_a_crossing_and_the_first_crossing_counts():
    errors = np.array([[0.0, 0.5, 0.5, 0.6, 0.1], [0.6, 0.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.5, 0.5, 0.5]])
    np.testing.assert_array_equal(valid_prediction_time(errors, 0.5), [3, 0, 5])


def test_backward_counts_from_the_end_of_the_part():
    errors = np.array([[9.0, 0.0, 9.0, 0.0, 0.0, 0.0, 9.0]])
    assert valid_prediction_time(errors, 1.0, part=(1, 6), backward=True)[0] == 3
    assert valid_prediction_time(errors, 1.0, part=(3, 6), backward=True)[0] == 3
    assert valid_prediction_time(errors, 1.0, backward=True)[0] == 0


@given(st.integers(0, 12), st.integers(1, 12))
def test_a_longer_horizon_never_shortens_the_time(crossing, length):
    errors = (np.arange(24) >= crossing).astype(float)[None]
    short = valid_prediction_time(errors[:, :length], 0.5)[0]
    assert short == min(crossing, length)
    assert valid_prediction_time(errors, 0.5)[0] >= short


def test_statistics_cover_the_mean_and_shrink_with_the_number(rng):
    few, many = rng.uniform(size=10), rng.uniform(size=1000)
    for values in (few, many):
        found = statistics(values)
        assert found["interval"][0] < found["mean"] < found["interval"][1]
        assert found == statistics(values)
    width = [np.ptp(statistics(values)["interval"]) for values in (few, many)]
    assert width[1] < 0.3 * width[0]


def test_mistakes_are_named():
    with pytest.raises(KeycldError, match="one shape"):
        frame_errors(np.zeros((1, 2, 3, 3, 3)), np.zeros((1, 1, 3, 3, 3)))
    with pytest.raises(KeycldError, match="0 ≤ start < stop ≤ 4"):
        valid_prediction_time(np.zeros((1, 4)), 1.0, part=(2, 5))
