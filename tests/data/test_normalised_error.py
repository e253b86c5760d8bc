"""The error of "Which priors matter?", against values computed by hand and scores measured with the suite."""

import numpy as np
import pytest

from keycld.data import normalised_errors
from keycld.data.describe.normalised_error import TABLE_UNITS, THRESHOLD, trivial_scores
from keycld.systems import Recording, get


def test_known_values():
    truth = np.random.RandomState(0).randint(1, 256, (2, 3, 8, 8, 3)).astype(np.uint8)
    x = truth / 255.0
    np.testing.assert_array_equal(normalised_errors(truth, truth), np.zeros((2, 3)))
    np.testing.assert_allclose(normalised_errors(truth, np.zeros((8, 8, 3))), np.ones((2, 3)))
    np.testing.assert_allclose(normalised_errors(truth, 0.5 * x), np.full((2, 3), 0.25), rtol=1e-6)
    np.testing.assert_allclose(normalised_errors(x, truth[0, 0]), normalised_errors(truth, x[0, 0]), rtol=1e-5)


def test_valid_frames_of_a_frozen_prediction():
    """A prediction of x (1 + e) has the error e²: here 0 in two frames, then 2.25 times the threshold."""
    test = np.full((1, 4, 2, 2, 3), 100, np.uint8)
    test[0, 2:] = round(100 / (1 + 1.5 * THRESHOLD**0.5))
    scores = trivial_scores([test], [test])["first_frame"]
    assert scores["below_threshold"] == 0.5 and scores["vpt"] == 0.5


def test_errors_in_the_papers_units():
    random = np.random.RandomState(0)
    train, test = (random.randint(0, 256, (3, 4, 32, 32, 3)).astype(np.uint8) for _ in range(2))
    scores = trivial_scores([train], [test[:1], test[1:]])["mean_image"]
    mean = train.reshape(-1, 32, 32, 3).mean(axis=0) / 255.0
    x = test.reshape(-1, 3072) / 255.0
    wanted = np.mean(np.sum((x - mean.reshape(1, -1)) ** 2, axis=1) / np.sum(x**2, axis=1))
    assert scores["normalised_error"] == pytest.approx(wanted, rel=1e-5)
    assert scores["table_units"] == pytest.approx(1e7 * wanted / 3072, rel=1e-5) and TABLE_UNITS > 3255
    assert scores["below_threshold"] == 0.0 and scores["vpt"] == 0.0
    still = np.broadcast_to(test[:, :1], test.shape)
    assert trivial_scores([train], [still])["first_frame"]["vpt"] == 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "published"), [("toy/mass_spring", 170), ("toy/two_body", 316), ("toy/pendulum", 266)]
)
def test_a_still_mean_picture_scores_what_it_does_in_the_suite(name, published):
    """Anchors measured with the suite's generator; the others are in validation/."""

    def some(first):
        recording = get(name).record(range(first, first + 1024), 256, "priors-released", "default")
        seen = Recording(recording.time[::16], recording.state[:, ::16], recording.parameters)
        return get(name).pictures(seen).image

    assert trivial_scores([some(0)], [some(5000)])["mean_image"]["table_units"] == pytest.approx(published, rel=0.03)
