"""The systems equal dm_control's with KeyCLD's changes: states, energies and pictures of its own run generator."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from keycld.data.generate.protocols import PROTOCOLS, splits
from keycld.systems import Conditions, get, render

GOLDEN = Path(__file__).parent / "golden"
CONDITIONS = {"": Conditions(), "_2024": Conditions(initial_state="random", input_limit=2.0, clip=False)}
NAMES = ("pendulum", "cartpole", "acrobot")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("version", CONDITIONS)
def test_seeds_replay_the_released_generator(name, version):
    system, golden = get(name), np.load(GOLDEN / f"{name}{version}.npz")
    for i, seed in enumerate(golden["seed"]):
        run = system.record(np.random.RandomState(seed), 50, CONDITIONS[version])
        np.testing.assert_allclose(run.input, golden["action"][i], atol=1e-12)
        np.testing.assert_allclose(run.time, golden["time"][i], atol=1e-12)
        np.testing.assert_allclose(run.state, golden["state"][i], atol=1e-8)
        kinetic, potential = system.energies(run.state)
        np.testing.assert_allclose(kinetic, golden["energy_kinetic"][i], atol=1e-7)
        np.testing.assert_allclose(potential, golden["energy_potential"][i], atol=1e-7)


def _released_initial_state(name, random):
    """What the released code of 2024 samples with control "no", in its order: input, reset, positions, velocities."""
    random.uniform(-2.0, 2.0, size=1 if name == "pendulum" else 2)
    if name == "cartpole":
        random.randn(), random.randn(), random.randn(2)
        place = random.uniform([-1.0, -np.pi], [1.0, np.pi])
    else:
        angles = 1 if name == "pendulum" else 2
        random.uniform(-np.pi, np.pi, size=angles)
        place = random.uniform(-np.pi, np.pi, size=angles)
    return np.concatenate([place, random.uniform(-0.1, 0.1, size=place.shape)])


@pytest.mark.parametrize("name", NAMES)
def test_undriven_runs_of_2024_skip_the_number_that_decides_on_a_zero_input(name):
    system, split = get(name), splits("keycld-2024", control="none")[0]
    for seed in range(3):
        run = system.record(np.random.RandomState(seed), 20, split.conditions)
        initial = _released_initial_state(name, np.random.RandomState(seed))
        wanted = system.simulate(initial, np.zeros(len(system.input_names)), 20, clip=False)
        np.testing.assert_array_equal(run.state, wanted.state)
        driven = dataclasses.replace(split.conditions, control="full")
        assert np.any(system.record(np.random.RandomState(seed), 20, driven).state != run.state)


def test_the_long_test_and_arxiv_v1_take_that_number():
    """Their data are unchanged, and so is what is recorded of them."""
    for protocol in PROTOCOLS:
        conditions = splits(protocol)[-1].conditions
        assert conditions.control == "none" and conditions.idle_number
    assert splits("keycld-2022", control="none")[0].conditions.idle_number
    assert "idle_number" not in splits("keycld-2024")[0].conditions.described()
    assert splits("keycld-2024", control="none")[0].conditions.described()["idle_number"] is False


@pytest.mark.parametrize("name", NAMES)
def test_pictures_are_dm_controls(name):
    golden = [np.load(GOLDEN / f"{name}{version}.npz") for version in CONDITIONS]
    states = np.concatenate([each["state"][:, each["frames"]].reshape(-1, each["state"].shape[-1]) for each in golden])
    wanted = np.concatenate([each["image"].reshape(-1, 64, 64, 3) for each in golden])
    pictures = render(get(name), states)
    difference = np.abs(pictures.image.astype(int) - wanted)
    if "llvmpipe" in pictures.renderer:
        near = np.all(difference <= 2, axis=-1)
        assert near.mean() >= 0.999
    else:
        assert difference.mean() < 1.0


def test_golden_pictures_can_fail():
    golden = np.load(GOLDEN / "pendulum.npz")
    shifted = golden["state"][:2, golden["frames"]].reshape(-1, 2) + np.array([0.1, 0.0])
    difference = np.abs(render(get("pendulum"), shifted).image.astype(int) - golden["image"][:2].reshape(-1, 64, 64, 3))
    assert np.all(difference <= 2, axis=-1).mean() < 0.999
