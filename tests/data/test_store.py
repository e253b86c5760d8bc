"""What is written is read back; a file is whole or absent."""

import dataclasses
import errno
import os

import h5py
import numpy as np
import pytest
from sample import assert_equal, sample

from keycld import KeycldError
from keycld.data import open_file, read, write
from keycld.data.format.folder import read_statistics
from keycld.data.format.writing import join
from scenes import disc_pendulum


@pytest.mark.parametrize("varying_input", [False, True])
def test_round_trip(tmp_path, varying_input):
    written = sample(varying_input=varying_input)
    write(tmp_path / "a.h5", written)
    found = read(tmp_path / "a.h5")
    assert_equal(found, written)
    assert found.image.dtype == np.uint8 and found.time.dtype == np.float64
    assert found.input.dtype == np.float32 and found.state.dtype == np.float64
    assert found.attributes == {"schema_version": 1, **written.attributes}
    assert (len(found), found.frames, found.dt) == (3, 5, 0.1)


def test_pictures_may_stay_on_the_disk(tmp_path):
    write(tmp_path / "a.h5", sample())
    assert read(tmp_path / "a.h5", images=False).image is None


def test_only_what_is_there_is_stored(tmp_path):
    bare = dataclasses.replace(sample(), state=None, state_derivative=None, parameters={})
    write(tmp_path / "a.h5", bare)
    with h5py.File(tmp_path / "a.h5") as file:
        assert set(file) == {"image", "input", "time"}
    assert_equal(read(tmp_path / "a.h5"), bare)


def test_images_are_chunked_by_trajectory_and_compressed(tmp_path):
    write(tmp_path / "a.h5", sample())
    with h5py.File(tmp_path / "a.h5") as file:
        assert file["image"].chunks == (1, 5, 8, 8, 3) and file["image"].compression == "gzip"


def test_a_file_rendered_later_needs_a_renderer(tmp_path):
    without = dataclasses.replace(sample(), image=None)
    with pytest.raises(KeycldError, match="'/image' is missing"):
        write(tmp_path / "a.h5", without)
    rendered_later = dataclasses.replace(
        without, attributes={**without.attributes, "renderer": "discs", "renderer_version": 1}
    )
    write(tmp_path / "a.h5", rendered_later)
    assert_equal(read(tmp_path / "a.h5"), rendered_later)


def test_joined_parts_are_the_whole(tmp_path):
    whole = sample(5)

    def part(first, last):
        return dataclasses.replace(
            whole,
            **{name: getattr(whole, name)[first:last] for name in ("input", "image", "state", "state_derivative")},
            parameters={name: value[first:last] for name, value in whole.parameters.items()},
        )

    write(tmp_path / "0.h5", part(0, 2))
    write(tmp_path / "1.h5", part(2, 5))
    join([tmp_path / "0.h5", tmp_path / "1.h5"], tmp_path / "joined.h5")
    assert_equal(read(tmp_path / "joined.h5"), whole)
    assert read(tmp_path / "joined.h5").attributes == read(tmp_path / "0.h5").attributes


def test_joined_undriven_parts(tmp_path):
    undriven = dataclasses.replace(sample(4), input=np.zeros((4, 0), np.float32))
    half = dataclasses.replace(
        undriven,
        **{name: getattr(undriven, name)[2:] for name in ("input", "image", "state", "state_derivative")},
        parameters={name: value[2:] for name, value in undriven.parameters.items()},
    )
    write(tmp_path / "0.h5", undriven)
    write(tmp_path / "1.h5", half)
    join([tmp_path / "0.h5", tmp_path / "1.h5"], tmp_path / "joined.h5")
    joined = read(tmp_path / "joined.h5")
    assert joined.input.shape == (6, 0)
    np.testing.assert_array_equal(joined.image, np.concatenate([undriven.image, half.image]))


def test_bad_contents_are_not_written(tmp_path):
    write(tmp_path / "a.h5", sample())
    broken = sample()
    broken.state[1, 2, 3] = np.nan
    with pytest.raises(KeycldError, match=r"'/state'\[1, 2, 3\] is nan"):
        write(tmp_path / "a.h5", broken)
    assert_equal(read(tmp_path / "a.h5"), sample())
    assert os.listdir(tmp_path) == ["a.h5"]


def test_an_unwritable_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(KeycldError, match="choose a folder that you may write to"):
        write(tmp_path / "file" / "a.h5", sample())
    write(tmp_path / "missing" / "a.h5", sample())
    assert [path.name for path in (tmp_path / "missing").iterdir()] == ["a.h5"]


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, "No space left on device"), OSError("No space left on device")]
)
def test_a_full_disk_is_reported_and_leaves_nothing(tmp_path, monkeypatch, error):
    def full(handle):
        raise error

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(KeycldError, match="the disk is full"):
        write(tmp_path / "a.h5", sample())
    assert os.listdir(tmp_path) == []


def test_a_file_that_may_not_be_read_is_not_called_damaged(tmp_path, monkeypatch):
    """Its fix would be to delete it."""
    (tmp_path / "statistics.json").write_text("{}")

    def refused(*given):
        raise PermissionError(errno.EACCES, "Permission denied")

    with monkeypatch.context() as patched, pytest.raises(KeycldError, match="^cannot read .*: check the path and its"):
        patched.setattr(os, "open", refused)
        read_statistics(tmp_path)
    with pytest.raises(KeycldError, match="statistics.json is damaged .*'splits' is missing.*: delete it"):
        read_statistics(tmp_path)


def test_without_memory_a_file_is_not_called_damaged(tmp_path):
    write(tmp_path / "a.h5", disc_pendulum(1, 3, seed=0))
    with pytest.raises(MemoryError), open_file(tmp_path / "a.h5"):
        raise MemoryError
