"""Training sets of any size: resident as a whole, or shard by shard, the same ones in every run."""

import dataclasses
import subprocess
import sys
import threading

import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sample import sample

from keycld import KeycldError
from keycld.data import RenderedLater, Resident, Windows, make_data, open_data, read, resident, write

COUNT, FRAMES, SIZE = 7, 5, 8
ONE = FRAMES * SIZE * SIZE * 3 + 2 * 4


@pytest.fixture
def data(tmp_path):
    """Seven trajectories, of which each picture and the input tell the number."""
    stored = sample(COUNT, FRAMES, SIZE)
    number = np.arange(COUNT)
    image = np.broadcast_to(number[:, None, None, None, None], stored.image.shape).astype(np.uint8)
    stored = dataclasses.replace(stored, image=image, input=np.stack([number, -number], 1).astype(np.float32))
    write(tmp_path / "train.h5", stored)
    return open_data(tmp_path)


def numbers(shard):
    found = np.asarray(shard.image[:, 0, 0, 0, 0]).astype(int)
    np.testing.assert_array_equal(np.asarray(shard.u), np.stack([found, -found], axis=1))
    return found.tolist()


def test_a_set_that_fits_is_resident_as_a_whole(data):
    source = data.training_data(0, budget_bytes=COUNT * ONE)
    assert source.shape == (COUNT, FRAMES, SIZE, SIZE, 3) and source.until(0) is None and source.until(10**6) is None
    whole = source.at(0)
    assert source.at(10**6) is whole and numbers(whole) == list(range(COUNT))
    known = resident(data.train())
    assert jax.tree.structure(whole) == jax.tree.structure(known)
    for one, other in zip(jax.tree.leaves(whole), jax.tree.leaves(known), strict=True):
        assert one.dtype == other.dtype and one.weak_type == other.weak_type
        np.testing.assert_array_equal(one, other)
    for one, other in zip(jax.tree.leaves(data.resident()), jax.tree.leaves(known), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_larger_set_is_resident_shard_by_shard(data):
    source = data.training_data(3, budget_bytes=4 * ONE, shard_steps=10)
    assert source.shape[0] == COUNT and source.shard == 2
    assert [source.until(step) for step in (0, 9, 10, 25)] == [10, 10, 20, 30]
    shards = [numbers(source.at(10 * k)) for k in range(7)]
    assert source.at(65) is source.at(60)
    # Seven shards of two are two whole passes, each in an order of its own.
    counts = np.bincount(np.concatenate(shards), minlength=COUNT)
    np.testing.assert_array_equal(counts, 2)
    first = [sorted(shards[0] + shards[1] + shards[2])] + [shards[3]]
    assert len(set(first[0])) == 6 and set(range(COUNT)) - set(first[0]) <= set(shards[3])


def test_seed_and_step_decide_what_is_resident(data):
    def shards(seed, steps):
        source = data.training_data(seed, budget_bytes=4 * ONE, shard_steps=10)
        return [numbers(source.at(step)) for step in steps]

    whole = shards(0, range(0, 100, 10))
    assert shards(0, [73]) == whole[7:8]  # a resumed run
    assert shards(0, [30, 0, 90, 91]) == [whole[3], whole[0], whole[9], whole[9]]
    assert shards(1, range(0, 100, 10)) != whole


def test_the_next_shard_is_read_in_the_meantime(data, monkeypatch):
    from keycld.data.sample import training_data

    readers, read_each = [], training_data.read_each

    def watched(*args, **kwargs):
        readers.append(threading.current_thread())
        return read_each(*args, **kwargs)

    monkeypatch.setattr(training_data, "read_each", watched)
    source = data.training_data(0, budget_bytes=4 * ONE, shard_steps=10)
    source.at(0)
    for thread in readers:
        thread.join(10)
    assert len(readers) == 2 and threading.current_thread() not in readers
    source.at(10)  # nothing but this shard's successor is read
    for thread in readers:
        thread.join(10)
    assert len(readers) == 3


def test_both_shards_stay_under_the_budget(data):
    budget = 5.5 * ONE
    source = data.training_data(0, budget_bytes=budget)
    held = sum(leaf.nbytes for leaf in jax.tree.leaves(source.at(0)) if leaf.ndim)
    assert 2 * held <= budget < 2 * held + 2 * ONE
    with pytest.raises(KeycldError, match="allow at least"):
        data.training_data(0, budget_bytes=1.5 * ONE)


def test_arrays_are_passed_to_the_device_without_a_copy(data):
    """A copy would take the memory twice, where the device is the CPU itself."""
    from keycld.data.sample.resident import on_device, on_host

    host = on_host([data.train()], COUNT)
    with jax.default_device(jax.devices("cpu")[0]):
        image = on_device(host, None, 0.1).image
    assert image.unsafe_buffer_pointer() == host.image.ctypes.data


def test_a_damaged_trajectory_is_named_by_the_shard_that_holds_it(data):
    with h5py.File(data.folder / "train.h5", "r+") as file:
        file["input"][4, 1] = np.nan
    source = data.training_data(0, budget_bytes=4 * ONE, shard_steps=1)
    with pytest.raises(KeycldError, match=r"'/input'\[4, 1\] is nan"):
        for step in range(4):
            source.at(step)


def test_states_are_resident_shard_by_shard_too(tmp_path):
    make_data(
        "toy/mass_spring_colors", tmp_path, runs={"train": 6, "test": 2}, frames={"train": 8, "test": 8}, workers=1
    )
    data = open_data(tmp_path)
    whole = data.resident()
    assert isinstance(whole.image, RenderedLater) and whole.u.shape == (5, 0)
    one = sum(leaf.nbytes for leaf in jax.tree.leaves(whole) if leaf.ndim) / 5
    source = data.training_data(0, budget_bytes=4 * one, shard_steps=3)
    assert source.shape == whole.shape == (5, 8, 32, 32, 3)
    for step in (0, 3, 6):
        shard, rows = source.at(step), source.trajectories(step // 3)
        assert isinstance(shard, Resident) and shard.shape == (2, 8, 32, 32, 3)
        np.testing.assert_array_equal(shard.image[0], whole.image[int(rows[0])])


def test_one_compiled_step_serves_all_shards(data):
    source = data.training_data(0, budget_bytes=4 * ONE, shard_steps=1)
    sampler, traced = Windows(3, 2), []

    @jax.jit
    def sampled(shard, key, step):
        traced.append(step)
        return sampler(shard, key, step)

    sampler.check(source)
    seen = [sampled(source.at(step), jax.random.key(0), jnp.array(step)).frames for step in range(3)]
    assert len(traced) == 1
    for step, frames in enumerate(seen):
        assert set(np.round(np.asarray(frames) * 255).astype(int).ravel()) <= set(source.trajectories(step).tolist())


def test_a_program_ends_while_a_shard_is_read(data):
    code = f"""
from keycld.data import open_data
source = open_data({str(data.folder)!r}).training_data(0, budget_bytes={4 * ONE}, shard_steps=1)
source.at(0)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0 and not done.stderr, done.stderr


def test_states_without_a_renderer_are_refused(tmp_path):
    states = dataclasses.replace(sample(), image=None)
    write(tmp_path / "train.h5", dataclasses.replace(states, attributes={**states.attributes, "renderer": "mine"}))
    assert read(tmp_path / "train.h5").image is None
    with pytest.raises(KeycldError, match="neither pictures nor states"):
        open_data(tmp_path).training_data(0)
