"""Trajectories of one simulation know of each other, so no two files share a simulation."""

import pytest

from keycld import KeycldError
from keycld.data.generate.protocols import splits
from keycld.data.generate.sampled import sampled_parts, sampled_recipe, sampled_splits
from keycld.systems import AbstractSampledSystem, get, names


def simulations(name, size, runs=None):
    """The simulations of train and of validation."""
    system = get(name)
    train, validation, *_ = sampled_splits(system, size, runs=runs)
    assert train.seeds[1] == validation.seeds[0]
    return [{number // system.related(size) for number in range(*split.seeds)} for split in (train, validation)]


@pytest.mark.parametrize("name", ["md/lj_4", "md/lj_16"])
@pytest.mark.parametrize(("size", "count"), [("default", n) for n in (71, 80, 139, 140, 700, 1000)] + [("full", 1500)])
def test_train_and_validation_share_no_simulation(name, size, count):
    train, validation = simulations(name, size, {"train": count})
    assert train and validation and not train & validation


def test_validation_is_rounded_up_to_whole_simulations():
    train, validation, *_ = sampled_splits(get("md/lj_4"), runs={"train": 700})
    assert (len(train), len(validation)) == (630, 70)
    train, validation, *_ = sampled_splits(get("md/lj_4"), runs={"train": 350})
    assert (len(train), len(validation)) == (280, 70)  # a tenth would be half a simulation


@pytest.mark.parametrize(("size", "related"), [("default", 70), ("full", 700)])
def test_one_simulation_cannot_be_two_files(size, related):
    message = f"at least {related + 1}, or {2 * related} for two whole simulations, not {related}"
    with pytest.raises(KeycldError, match=message):
        sampled_splits(get("md/lj_4"), size, runs={"train": related})


@pytest.mark.parametrize("runs", [None, {"train": 300, "test": 100}])
@pytest.mark.parametrize("name", names(AbstractSampledSystem))
def test_parts_of_the_work_share_no_simulation(name, runs, tmp_path):
    system = get(name)
    recipe = sampled_recipe(system, protocol=None, size="default", store=None, runs=runs, frames=None)
    parts = sampled_parts(system, recipe, tmp_path)
    numbers = [part.task.arguments[1] for part in parts]
    assert sum(len(each) for each in numbers) == sum(len(split) for split in sampled_splits(system, runs=runs))
    held = [{number // system.related("default") for number in each} for each in numbers]
    assert sum(len(each) for each in held) == len(set().union(*held))


def test_the_long_test_of_a_small_set_is_small():
    def numbers(plan):
        return {split.name: len(split) for split in plan}

    pendulum = get("toy/pendulum")
    assert numbers(sampled_splits(pendulum, runs={"test": 2}))["test_long"] == 2
    assert numbers(sampled_splits(pendulum, runs={"test": 500}))["test_long"] == 200
    assert numbers(sampled_splits(pendulum, runs={"test": 2, "test_long": 3}))["test_long"] == 3
    plan = splits("keycld-2022", runs={"test": 2})
    assert {split.name: split.seeds[1] - split.seeds[0] for split in plan}["test_long"] == 2
