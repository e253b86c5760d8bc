"""Data sets of "Which priors matter?": splits, states that are rendered later, resumption, figures."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sample import assert_equal

from keycld import KeycldError
from keycld.data import (
    FrameGroups,
    RenderedLater,
    WholeTrajectories,
    check,
    make_data,
    open_data,
    read,
    resident,
    with_derivative,
    with_pictures,
    write,
)
from keycld.data.format import derived
from keycld.data.format.writing import join
from keycld.data.generate.sampled import sampled_parts, sampled_recipe, sampled_splits
from keycld.systems import AbstractSampledSystem, Recording, get, names

NAME = "toy/mass_spring_colors"
RUNS = {"train": 20, "test": 4, "test_long": 2}
FRAMES = {"train": 30, "test": 30, "test_long": 40}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Twenty-six trajectories, stored as states."""
    folder = tmp_path_factory.mktemp("data") / "spring"
    made = make_data(NAME, folder, runs=RUNS, frames=FRAMES, workers=1)
    assert made.fresh and made.renderer == "soft discs"
    return folder


def test_all_seventeen_sets_are_there():
    found = names(AbstractSampledSystem)
    assert len(found) == 17
    long = {name for name in found if "test_long" in get(name).counts["default"]}
    assert long == {
        "toy/mass_spring", "toy/mass_spring_colors", "toy/pendulum", "toy/pendulum_colors",
        "games/matching_pennies", "games/rock_paper_scissors",
    }  # fmt: skip


@pytest.mark.parametrize("name", names(AbstractSampledSystem))
def test_splits_of_the_full_size(name):
    train, validation, test, *long = sampled_splits(get(name), "full")
    assert (len(train), len(validation), len(test)) == (49_000, 1_000, 20_000)
    assert train.seeds[1] == validation.seeds[0] and train.frames == test.frames == 256
    ranges = sorted(split.seeds for split in (train, validation, test, *long))
    assert all(one[1] <= other[0] for one, other in zip(ranges, ranges[1:], strict=False))
    assert all(split.frames == 1000 for split in long)


def test_small_training_sets_give_a_tenth_to_validation():
    train, validation, *_ = sampled_splits(get(NAME), runs={"train": 2000})
    assert (train.seeds, validation.seeds) == ((0, 1800), (1800, 2000))
    with pytest.raises(KeycldError, match="unknown split"):
        sampled_splits(get(NAME), runs={"validation": 3})
    with pytest.raises(KeycldError, match="unknown split"):
        sampled_splits(get("toy/two_body"), runs={"test_long": 3})
    with pytest.raises(KeycldError, match="--train is a number of recordings, at least 2 and at most 1,000,000, not 1"):
        sampled_splits(get(NAME), runs={"train": 1})
    with pytest.raises(KeycldError, match="test is a number of frames, at least 3 and at most 1,000,000, not 2"):
        sampled_splits(get(NAME), frames={"test": 2})


@pytest.mark.parametrize("size", ["default", "full"])
def test_simulations_of_molecules_are_not_shared_between_files(size, tmp_path):
    """Neighbouring windows of one simulation know of each other."""
    system = get("md/lj_4")
    from keycld.systems.molecular.lennard_jones import WINDOWS

    splits = sampled_splits(system, size)
    simulations = [{number // WINDOWS[size] for number in range(*split.seeds)} for split in splits]
    assert not (simulations[0] & simulations[1] or simulations[0] & simulations[2])
    recipe = sampled_recipe(system, protocol=None, size=size, store=None, runs=None, frames=None)
    parts = sampled_parts(system, recipe, tmp_path)
    assert sum(part.frames for part in parts) == sum(len(split) * split.frames for split in splits)


def test_a_set_of_states_is_whole_and_sound(folder):
    assert check(folder) == []
    train = read(folder / "train.h5")
    assert train.image is None and train.state.shape == (18, 30, 2) and train.input.shape == (18, 0)
    assert train.attributes["renderer"] == "soft discs" and train.attributes["renderer_version"] == 1
    assert train.attributes["protocol"] == "priors-released"
    recording = get(NAME).record(range(18), 30, "priors-released", "default")
    np.testing.assert_array_equal(train.state, recording.state)
    np.testing.assert_array_equal(train.time, recording.time)
    for name, value in recording.parameters.items():
        np.testing.assert_array_equal(train.parameters[name], value)
    assert {path.name for path in folder.iterdir()} == {
        "train.h5", "validation.h5", "test.h5", "test_long.h5", "README.md", "statistics.json", "preview.gif",
        ".lock",
    }  # fmt: skip


def test_opening_renders(folder):
    test = open_data(folder).test()
    assert test.image.shape == (4, 30, 32, 32, 3)
    rendered = get(NAME).pictures(Recording(test.time, test.state, dict(test.parameters))).image
    np.testing.assert_array_equal(test.image, rendered)
    some = open_data(folder).split("test", rows=slice(1, 3))
    np.testing.assert_array_equal(some.image, test.image[1:3])
    np.testing.assert_array_equal(some.state, test.state[1:3])
    assert open_data(folder).count("test") == 4 and open_data(folder).split("test", images=False).image is None


def test_stored_pictures_are_the_rendered_ones(folder, tmp_path):
    make_data(NAME, tmp_path / "a", runs=RUNS, frames=FRAMES, workers=1, store="images")
    stored = read(tmp_path / "a" / "test.h5")
    assert "renderer_version" not in stored.attributes
    np.testing.assert_array_equal(stored.image, open_data(folder).test().image)
    with pytest.raises(KeycldError, match="another store"):
        make_data(NAME, tmp_path / "a", runs=RUNS, frames=FRAMES, workers=1)


@pytest.mark.parametrize("sampler", [FrameGroups(4, 2, (6,), 10.0), WholeTrajectories(30)])
def test_clips_are_rendered_inside_the_step(folder, sampler):
    """The same clips, bit for bit, from states as from pictures, in a compiled step."""
    states = open_data(folder).split("train", images=False)
    later, now = open_data(folder).resident(), resident(with_pictures(states))
    assert isinstance(later.image, RenderedLater) and isinstance(now.image, jax.Array)
    assert later.image.shape == now.image.shape == (18, 30, 32, 32, 3)
    sampler.check(later)
    sample = jax.jit(lambda data, key: sampler(data, key, jnp.array(3)))
    one, other = sample(later, jax.random.key(0)), sample(now, jax.random.key(0))
    difference = np.abs(np.asarray(one.frames) - np.asarray(other.frames)) * 255
    # Compiled together with the rest, a byte in some ten thousand may fall on the other side of a level.
    assert difference.max() < 1.01 and np.mean(difference > 0.5) < 1e-3
    np.testing.assert_array_equal(one.index, other.index)


def test_states_reach_nothing_but_the_renderer(folder):
    """The device holds positions of discs, and neither momenta nor the state."""
    states = open_data(folder).split("train", images=False)
    data = resident(states)
    assert data.image.visible.shape == (18, 30, 2)
    assert not any(np.shape(leaf) == states.state.shape and np.allclose(leaf, states.state) for leaf in
                   jax.tree.leaves(data))  # fmt: skip
    moved = dataclasses.replace(states, state=states.state * np.array([1.0, 5.0]))
    for one, other in zip(jax.tree.leaves(data), jax.tree.leaves(resident(moved)), strict=True):
        np.testing.assert_array_equal(one, other)


def test_pictures_rendered_later_can_be_indexed(folder):
    states = open_data(folder).split("train", images=False)
    rendered, image = resident(states).image, with_pictures(states).image
    assert len(rendered) == 18
    for found, wanted in (
        (rendered[3], image[3]),
        (
            rendered[jnp.array([[1], [4]]), jnp.array([[0, 2, 5], [1, 1, 29]])],
            image[[[1], [4]], [[0, 2, 5], [1, 1, 29]]],
        ),
        (np.asarray(rendered)[:2], image[:2]),
    ):
        assert found.dtype == np.uint8 and found.shape == wanted.shape
        assert np.abs(np.asarray(found).astype(int) - wanted).max() <= 1


def test_an_unknown_or_newer_renderer(folder, tmp_path):
    states = read(folder / "test.h5")
    newer = dataclasses.replace(states, attributes={**states.attributes, "renderer_version": 2})
    with pytest.raises(KeycldError, match="version 2 of 'soft discs', but this keycld has version 1"):
        with_pictures(newer)
    foreign = dataclasses.replace(states, attributes={**states.attributes, "renderer": "mine"})
    assert with_pictures(foreign).image is None
    with pytest.raises(KeycldError, match="neither pictures nor states"):
        resident(foreign)


def test_more_pictures_than_memory_holds_are_refused(folder, monkeypatch):
    monkeypatch.setattr(derived, "MOST_BYTES", 1e5)
    data = open_data(folder)
    with pytest.raises(KeycldError, match=r"read fewer of them \(rows=slice"):
        data.test()
    assert data.split("test", rows=slice(0, 1)).image.shape == (1, 30, 32, 32, 3)
    assert sum(len(block.image) for block in data.blocks("test", 1)) == 4


def test_derivatives_are_computed_on_reading(folder):
    test = open_data(folder).split("test", images=False)
    derivative = with_derivative(test).state_derivative
    np.testing.assert_allclose(derivative[..., 0], test.state[..., 1] / test.parameters["m"][:, None])
    np.testing.assert_allclose(derivative[..., 1], -2.0 * test.state[..., 0])
    with pytest.raises(KeycldError, match="no derivative"):
        with_derivative(dataclasses.replace(test, attributes={**test.attributes, "system": "mine"}))


def test_interrupted_work_is_resumed(folder, tmp_path):
    def stop(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_data(NAME, tmp_path / "a", runs=RUNS, frames=FRAMES, workers=1, progress=stop)
    assert "unfinished" in " ".join(check(tmp_path / "a"))
    resumed = make_data(NAME, tmp_path / "a", runs=RUNS, frames=FRAMES, workers=1)
    assert 0 < resumed.frames < 24 * 30 + 2 * 40
    for name in ("train", "validation", "test", "test_long"):
        assert_equal(read(tmp_path / "a" / f"{name}.h5"), read(folder / f"{name}.h5"))
    again = make_data(NAME, tmp_path / "a", runs=RUNS, frames=FRAMES)
    assert not again.fresh


def test_files_are_put_together(folder, tmp_path):
    with_images = with_pictures(read(folder / "train.h5"))
    texts = {**with_images.parameters, "word": np.array(["grün"] * 18)}
    with_images = dataclasses.replace(with_images, parameters=texts)
    for name, rows in (("0", slice(0, 7)), ("1", slice(7, 18))):
        part = dataclasses.replace(
            with_images,
            **{field: getattr(with_images, field)[rows] for field in ("input", "image", "state")},
            parameters={key: value[rows] for key, value in texts.items()},
        )
        write(tmp_path / f"{name}.h5", part)
    join([tmp_path / "0.h5", tmp_path / "1.h5"], tmp_path / "joined.h5")
    assert_equal(read(tmp_path / "joined.h5"), with_images)
    assert check(tmp_path / "joined.h5") == []


def test_bad_values_are_found_in_the_rows_that_are_read(folder, tmp_path):
    import h5py

    (tmp_path / "a.h5").write_bytes((folder / "train.h5").read_bytes())
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["state"][11, 3, 1] = np.nan
    assert len(read(tmp_path / "a.h5", rows=slice(0, 5))) == 5
    with pytest.raises(KeycldError, match=r"'/state'\[11, 3, 1\] is nan"):
        read(tmp_path / "a.h5", rows=slice(5, 18))


def test_the_card_and_its_figures(folder):
    card = (folder / "README.md").read_text()
    for word in (
        "k/m",
        "18 × 30",
        "not stored but rendered",
        "units of tables 5 and 6",
        "| m | 0.2",
        "priors-released",
    ):
        assert word in card, word
    figures = json.loads((folder / "statistics.json").read_text())
    train = read(folder / "train.h5")
    assert figures["parameters"]["m"]["least"] == train.parameters["m"].min()
    assert figures["conserved"]["largest_change"] < 1e-12
    assert figures["splits"]["test"]["epsilon"] > 0 and figures["splits"]["train"]["motion_per_frame"]["q"]


def test_what_does_not_go_together(tmp_path):
    with pytest.raises(KeycldError, match="has no motors"):
        make_data(NAME, tmp_path / "a", control="none")
    with pytest.raises(KeycldError, match="unknown protocol 'priors-paper' of games/matching_pennies"):
        make_data("games/matching_pennies", tmp_path / "a", protocol="priors-paper")
    with pytest.raises(KeycldError, match="pictures are stored"):
        make_data("room/circle", tmp_path / "a", store="states")
    with pytest.raises(KeycldError, match="one size"):
        make_data("pendulum", tmp_path / "a", size="full")
    with pytest.raises(KeycldError, match="did you mean 'toy/pendulum_colors'"):
        make_data("toy/pendulum_colours", tmp_path / "a")
    assert not (tmp_path / "a").exists()


def test_names_with_a_slash_mean_folders_under_data(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(KeycldError, match="make them with 'keycld data make toy/mass_spring_colors'"):
        open_data(NAME)
    (tmp_path / "data" / "toy").mkdir(parents=True)
    (tmp_path / "data" / NAME).symlink_to(folder)
    assert len(open_data(NAME).test()) == 4


def test_rooms_are_stored_as_pictures(tmp_path):
    make_data("room/circle", tmp_path, runs={"train": 4, "test": 2}, frames={"train": 4, "test": 4}, workers=1)
    assert check(tmp_path) == []
    test = open_data(tmp_path).test()
    assert test.image.shape == (2, 4, 32, 32, 3) and test.parameters["place"].shape == (2, 5, 2)
    assert "conserved" not in json.loads((tmp_path / "statistics.json").read_text())
