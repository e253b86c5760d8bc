import dataclasses

import numpy as np
import pytest

import scenes
from keycld import KeycldError
from keycld.data import DataSet, write
from keycld.evaluation import Protocol, baseline_predictions, frame_errors, references
from keycld.evaluation.baselines import extrapolate
from keycld.evaluation.geometry import difference, embed, nearest
from swing import without_pictures

ANGLE = np.array([True])
FORWARD = Protocol("all", "test", 24)
BACKWARD = dataclasses.replace(FORWARD, direction="backward")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("disc")
    for k, (name, count) in enumerate((("train", 150), ("validation", 6), ("test", 6))):
        write(folder / f"{name}.h5", scenes.disc_pendulum(count, 24, seed=k))
    return DataSet(folder, None)


def errors_of(window, protocol, shared):
    return {name: frame_errors(window.image, found) for name, found in baseline_predictions(window, protocol, shared)}


def test_a_parabola_is_continued_exactly():
    k = np.arange(20.0)
    q = np.stack([0.3 + 0.2 * k - 0.01 * k**2, -0.1 * k], axis=-1)[None]
    found = extrapolate(q[:, :3], 20, np.array([False, False]))
    np.testing.assert_allclose(found, q, atol=1e-12)


def test_angles_that_jump_at_a_full_turn_are_continued():
    q = (3.0 + 0.1 * np.arange(10.0))[None, :, None]
    wrapped = (q + np.pi) % (2 * np.pi) - np.pi
    found = extrapolate(wrapped[:, :3], 10, ANGLE)
    np.testing.assert_allclose(difference(found, q, ANGLE), 0.0, atol=1e-12)


def test_nearest_configuration_is_found_across_the_cut_of_the_angle():
    points = embed(np.array([[3.1], [0.0], [-2.0]]), ANGLE)
    assert nearest(embed(np.array([[-3.1], [-1.6]]), ANGLE), points).tolist() == [0, 2]


@pytest.mark.parametrize("units", ["rad", ["rad"]])
def test_a_state_of_one_number_gives_no_parabola(units, tmp_path):
    """An angle alone, as some record it: it has no rate, so its first half is no position."""
    for k, name in enumerate(("train", "validation", "test")):
        made = scenes.disc_pendulum(2, 6, seed=k)
        named = {**made.attributes, "state_names": "angle", "units": units}
        write(tmp_path / f"{name}.h5", dataclasses.replace(made, state=made.state[..., :1], attributes=named))
    data = DataSet(tmp_path, None)
    errors = errors_of(data.test(), dataclasses.replace(FORWARD, horizon=6), references(data))
    assert set(errors) == {"mean image", "frozen frame"}


def test_baselines_know_what_they_should(data):
    shared = references(data)
    errors = errors_of(data.test(), FORWARD, shared)
    assert set(errors) == {"mean image", "frozen frame", "constant acceleration"}
    np.testing.assert_array_equal(errors["frozen frame"][:, :2], 0.0)
    assert errors["frozen frame"][:, 5:].mean() > errors["frozen frame"][:, 2].mean()
    assert errors["mean image"].mean() == pytest.approx(shared.epsilon, rel=0.2)
    # With the true states, the parabola is best at first and wrong after a quarter of a swing.
    early, late = errors["constant acceleration"][:, :5].mean(), errors["constant acceleration"][:, -4:].mean()
    assert early < 0.2 * shared.epsilon
    assert late > 5 * early


def test_the_past_is_the_future_of_the_reversed_motion(data):
    shared, test = references(data), data.test()
    reversed_ = dataclasses.replace(test, image=test.image[:, ::-1].copy(), state=test.state[:, ::-1].copy())
    backward, forward = errors_of(test, BACKWARD, shared), errors_of(reversed_, FORWARD, shared)
    for name, errors in forward.items():
        np.testing.assert_array_equal(backward[name], errors[:, ::-1])


def test_without_true_states_two_baselines_remain(data):
    test = dataclasses.replace(data.test(), state=None)
    assert set(errors_of(test, FORWARD, references(data))) == {"mean image", "frozen frame"}


def test_large_sets_are_read_in_part(data, monkeypatch):
    """At most 40 of 150 trajectories, evenly spread, and about 100 of their frames; the result says how many."""
    monkeypatch.setattr("keycld.evaluation.reference_images._MOST_TRAJECTORIES", 40)
    monkeypatch.setattr("keycld.evaluation.reference_images._MOST_RETRIEVED", 100)
    shared = references(data)
    train = data.train()
    # Every fourth trajectory; 38 · 24 frames in steps of 11, the first number from 10 on without a factor of 24.
    np.testing.assert_allclose(shared.mean_image, train.image[::4].mean(axis=(0, 1)) / 255.0, atol=1e-6)
    picked = train.image[::4].reshape(-1, 16, 16, 3)[::11]
    np.testing.assert_array_equal(shared.images, picked)
    np.testing.assert_array_equal(shared.states, train.state[::4].reshape(-1, 2)[::11])
    assert shared.sources == {"validation_trajectories": 6, "train_trajectories": 38, "retrieved_frames": len(picked)}


def test_data_without_pictures_are_refused(tmp_path):
    for name in ("train", "validation"):
        write(tmp_path / f"{name}.h5", without_pictures(scenes.disc_pendulum(2, 5, seed=0)))
    with pytest.raises(KeycldError, match="no /image"):
        references(DataSet(tmp_path, None))
