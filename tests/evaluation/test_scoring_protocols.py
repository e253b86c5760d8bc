import dataclasses

import pytest

import scenes
from keycld import KeycldError
from keycld.data import DataSet, write
from keycld.evaluation import Protocol, protocol_named, protocols_for, standard_protocols


def test_the_standard_list():
    found = {p.name: (p.split, p.horizon, p.given) for p in standard_protocols()}
    assert found == {
        "test@50": ("test", 50, 2),
        "validation@50": ("validation", 50, 2),
        "test_long@200": ("test_long", 200, 2),
        "test_long@500": ("test_long", 500, 2),
    }
    assert all(p.factors == (1.0, 0.25) for p in standard_protocols())


def test_three_given_frames_have_their_own_names():
    found = {p.name: (p.split, p.horizon, p.given) for p in standard_protocols(given=3)}
    assert found["test_long@200-given-3"] == ("test_long", 200, 3) and len(found) == 4
    assert protocol_named("validation@50-given-3").given == 3


def test_data_of_the_journal_version_give_three_frames(tmp_path):
    recordings = scenes.disc_pendulum(1, 12, seed=0)
    attributes = {**recordings.attributes, "protocol": "keycld-2024"}
    write(tmp_path / "test.h5", dataclasses.replace(recordings, attributes=attributes))
    (found,) = protocols_for(DataSet(tmp_path, None))
    assert (found.name, found.given, found.horizon) == ("test@12-given-3", 3, 12)


def test_a_model_that_starts_from_three_frames_gets_three(tmp_path):
    write(tmp_path / "test.h5", scenes.disc_pendulum(1, 12, seed=0))
    (found,) = protocols_for(DataSet(tmp_path, None), needed=3)
    assert (found.name, found.given) == ("test@12-given-3", 3)


def test_shorter_recordings_are_scored_to_their_end(tmp_path):
    for name, frames in (("test", 12), ("validation", 60), ("test_long", 250)):
        write(tmp_path / f"{name}.h5", scenes.disc_pendulum(1, frames, seed=0))
    found = {p.name: (p.split, p.horizon) for p in protocols_for(DataSet(tmp_path, None))}
    assert found == {
        "test@12": ("test", 12),
        "validation@50": ("validation", 50),
        "test_long@200": ("test_long", 200),
        "test_long@250": ("test_long", 250),
    }


def test_a_wrong_name_gets_the_nearest():
    with pytest.raises(KeycldError, match="did you mean 'test@50'"):
        protocol_named("test@5O")


def test_something_must_be_left_to_predict():
    with pytest.raises(KeycldError, match="fewer than all"):
        Protocol("x", "test", horizon=2, given=2)
