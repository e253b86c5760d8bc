"""The papers' protocols and the screen of the long test."""

import dataclasses

import numpy as np
import pytest

from keycld import KeycldError
from keycld.data.generate.parts import record
from keycld.data.generate.protocols import splits
from keycld.systems import AbstractMujocoSystem, get, names


def test_seeds_of_the_2022_protocol():
    train, validation, test, long = splits("keycld-2022")
    assert (train.seeds, validation.seeds, test.seeds) == ((0, 450), (450, 500), (500, 550))
    assert (long.seeds, long.frames, long.screened) == ((1000, 1050), 500, True)
    assert (train.conditions.control, train.conditions.initial_state, train.conditions.clip) == ("full", "rest", True)
    assert (long.conditions.control, long.conditions.initial_state) == ("none", "released")


def test_the_2024_protocol_starts_at_random_without_limits():
    train = splits("keycld-2024")[0]
    assert (train.conditions.initial_state, train.conditions.input_limit, train.conditions.clip) == (
        "random",
        2.0,
        False,
    )


def test_changed_conditions_leave_the_long_test_alone():
    train, _, _, long = splits("keycld-2022", control="none", initial_state="random")
    assert (train.conditions.control, train.conditions.initial_state) == ("none", "random")
    assert long.conditions.initial_state == "released"


def test_the_zoo_is_in_motion_in_all_files():
    plan = splits("zoo")
    assert [(split.seeds, split.frames) for split in plan] == [
        ((0, 450), 50),
        ((450, 500), 50),
        ((500, 550), 50),
        ((1000, 1050), 200),
    ]
    assert all(split.screened and split.conditions.initial_state == "moving" for split in plan)
    assert [split.conditions.control for split in plan] == ["full", "full", "full", "none"]
    assert plan[0].conditions.input == "constant"


def test_no_recording_is_in_two_files():
    many = splits("keycld-2022", runs={"train": 4500, "validation": 51, "test": 600, "test_long": 2})
    seeds = [seed for split in many for seed in range(*split.seeds)]
    assert len(seeds) == len(set(seeds)) == 4500 + 51 + 600 + 2


def test_bad_numbers_and_names():
    with pytest.raises(KeycldError, match="unknown protocol 'keycld-2023': did you mean"):
        splits("keycld-2023")
    with pytest.raises(KeycldError, match="unknown split 'tests': did you mean 'test'"):
        splits("keycld-2022", runs={"tests": 3})
    with pytest.raises(KeycldError, match="--train is a number of recordings, at least 1 and at most 1,000,000, not 0"):
        splits("keycld-2022", runs={"train": 0})
    with pytest.raises(KeycldError, match="test is a number of frames, at least 3 and at most 1,000,000, not 2"):
        splits("keycld-2022", frames={"test": 2})


@pytest.mark.parametrize("name", names(AbstractMujocoSystem))
def test_long_runs_stay_in_the_picture_and_can_be_followed(name):
    system, long = get(name), splits("keycld-2022")[3]
    for seed in range(1000, 1005):
        run, draws = record(system, long, seed)
        assert draws >= 1 and run.state.shape[0] == 500
        assert not np.any(run.input)
        assert np.all(np.abs(system.landmarks(run.state)) <= 1.0)
        half = len(system.units) // 2
        angles = [unit == "rad" for unit in system.units[:half]]
        assert np.abs(np.diff(run.state[:, :half][:, angles], axis=0)).max() <= 1.0


def test_the_screen_draws_again():
    system = get("pendulum")
    # No pendulum of this length turns 1 rad in a frame by itself; one driven at its limit does.
    fast = dataclasses.replace(
        splits("keycld-2022")[0], screened=True, conditions=dataclasses.replace(splits("keycld-2022")[0].conditions)
    )
    assert record(system, fast, 0)[1] == 1
    wild = dataclasses.replace(
        fast, frames=150, conditions=dataclasses.replace(fast.conditions, input_limit=100.0, clip=False)
    )
    draws = [record(system, wild, seed)[1] for seed in range(5)]
    assert max(draws) > 1
