"""Opening data: by a system's name, by folder, foreign data with its own constraints, movies."""

import dataclasses

import h5py
import imageio.v3
import numpy as np
import pytest
from sample import assert_equal, sample

from keycld import KeycldError
from keycld.data import check, open_data, read, show, write

CONSTRAINTS = """
keypoints = ["left", "right"]

[[constraint]]
kind = "fixed_distance"
between = ["left", "right"]
"""


@pytest.fixture
def folder(tmp_path):
    for i, name in enumerate(("train", "validation", "test")):
        write(tmp_path / f"{name}.h5", sample(3 + i))
    return tmp_path


def test_splits_and_attributes(folder):
    data = open_data(folder)
    assert data.splits == ("test", "train", "validation")
    assert (len(data.train()), len(data.validation()), len(data.test())) == (3, 4, 5)
    assert (data.system, data.dt) == ("pendulum", 0.1)
    assert data.sweeps() == () and data.statistics is None
    with pytest.raises(KeycldError, match="has no test_long.h5, only test, train, validation"):
        data.split("test_long")


def test_a_known_system_brings_its_keypoints(folder):
    assert open_data(folder).keypoints == ("tip",)
    assert open_data(folder).constraints.count == 1


def test_a_file_in_the_folder_brings_others(folder):
    (folder / "constraints.toml").write_text(CONSTRAINTS)
    assert open_data(folder).keypoints == ("left", "right")


def test_a_given_file_wins(folder, tmp_path_factory):
    given = tmp_path_factory.mktemp("given") / "mine.toml"
    given.write_text(CONSTRAINTS)
    assert open_data(folder, constraints=given).constraints.count == 1
    with pytest.raises(KeycldError, match="no constraints file"):
        open_data(folder, constraints=folder / "missing.toml")


def test_foreign_data_need_constraints_only_for_models_that_do(tmp_path):
    foreign = sample()
    foreign = dataclasses.replace(foreign, attributes={**foreign.attributes, "system": "my swing"})
    write(tmp_path / "train.h5", foreign)
    data = open_data(tmp_path)
    assert len(data.train()) == 3
    assert data.constraints is None and data.keypoints == ()
    (tmp_path / "constraints.toml").write_text(CONSTRAINTS)
    assert open_data(tmp_path).keypoints == ("left", "right")


def test_a_file_written_with_h5py_alone(tmp_path):
    """The least that the documentation promises to be enough."""
    for name in ("train", "validation", "test"):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            file["image"] = np.zeros((2, 3, 8, 8, 3), np.uint8)
            file["time"] = np.array([0.0, 0.1, 0.2])
            file.attrs.update(schema_version=1, system="swing", dt=0.1)
    assert check(tmp_path) == []
    train = open_data(tmp_path).train()
    assert train.input.shape == (2, 0) and train.input.dtype == np.float32 and train.state is None
    assert open_data(tmp_path).input_names == ()


def test_a_systems_name_means_its_folder_under_data(folder, tmp_path_factory, monkeypatch):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    monkeypatch.chdir(elsewhere)
    with pytest.raises(KeycldError, match="make them with 'keycld data make pendulum'"):
        open_data("pendulum")
    (elsewhere / "data").mkdir()
    (elsewhere / "data" / "pendulum").symlink_to(folder)
    assert_equal(open_data("pendulum").train(), read(folder / "train.h5"))


def test_what_is_not_data(folder, tmp_path_factory):
    empty = tmp_path_factory.mktemp("empty")
    with pytest.raises(KeycldError, match="holds no .h5 file"):
        open_data(empty)
    with pytest.raises(KeycldError, match="is a file: give the folder"):
        open_data(folder / "train.h5")
    (empty / "swing.mp4").touch()
    with pytest.raises(KeycldError, match=r"keycld data import .*swing.mp4 --out FOLDER.*keycld watch .*swing.mp4"):
        open_data(empty / "swing.mp4")
    with pytest.raises(KeycldError, match="there is no folder"):
        open_data(empty / "missing")
    with pytest.raises(KeycldError, match="did you mean 'pendulum'"):
        open_data("pendulm")
    (folder / ".partial").mkdir()
    with pytest.raises(KeycldError, match="unfinished"):
        open_data(folder)


def test_inputs_have_names(folder):
    assert open_data(folder).input_names == ("input 1", "input 2")
    named = sample()
    named = dataclasses.replace(named, attributes={**named.attributes, "input_names": ("force", "torque")})
    write(folder / "train.h5", named)
    assert open_data(folder).input_names == ("force", "torque")


@pytest.mark.parametrize("images", [True, False])
def test_blocks_are_the_split_in_pieces(folder, images):
    data = open_data(folder)
    found = list(data.blocks("test", 2, images=images))
    assert [len(block) for block in found] == [2, 2, 1]
    whole = data.split("test", images=images)
    for name in ("input", "state", "image") if images else ("input", "state"):
        joined = np.concatenate([getattr(block, name) for block in found])
        np.testing.assert_array_equal(joined, getattr(whole, name))
    assert images or found[0].image is None
    assert all(block.attributes == whole.attributes for block in found)


def test_movies(folder, tmp_path):
    train = open_data(folder).train()
    show(train, tmp_path / "a.gif", trajectory=-1, scale=2)
    frames = imageio.v3.imread(tmp_path / "a.gif", index=None)
    assert frames.shape[:3] == (5, 16, 16)
    with pytest.raises(KeycldError, match="no recording 3: choose 0 to 2"):
        show(train, tmp_path / "a.gif", trajectory=3)
    with pytest.raises(KeycldError, match=".mp4 or .gif"):
        show(train, tmp_path / "a.avi")


def test_fast_pictures_keep_their_speed_in_a_gif(tmp_path):
    fast = sample(1, frames=40)
    fast = dataclasses.replace(fast, time=fast.time / 10, attributes={**fast.attributes, "dt": 0.01})
    show(fast, tmp_path / "a.gif", scale=1)
    about = imageio.v3.immeta(tmp_path / "a.gif")
    frames = imageio.v3.imread(tmp_path / "a.gif", index=None)
    assert len(frames) == 20 and about["duration"] == 20
