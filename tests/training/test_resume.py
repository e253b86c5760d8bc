"""A run that was cut anywhere ends with the same bits as one that was not."""

import json
import shutil

import jax
import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.training import finished, load_run, train
from keycld.training.checkpoints import latest_checkpoint, load_leaves, save_checkpoint
from scenes import TINY


@pytest.fixture(scope="module")
def whole(tmp_path_factory, trained):
    root = shutil.copytree(trained, tmp_path_factory.mktemp("resume"), dirs_exist_ok=True)
    return root, root / "mine", load_run(root / "whole")[0]


def leaves(model):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(model)]


def cut(root, stage: int, done: bool):
    """A copy of the run as a kill would have left it at its checkpoint in, or at the end of, a stage."""
    copy = root / f"cut-{stage}-{done}"
    shutil.copytree(root / "whole", copy)
    for checkpoint in sorted((copy / "checkpoints").iterdir()):
        if checkpoint.is_dir():
            position = json.loads((checkpoint / "position.json").read_text())
            if position["stage"] == stage and position["done"] == done:
                (copy / "checkpoints" / "latest").write_text(checkpoint.name)
                return copy
    raise AssertionError(f"no checkpoint of stage {stage}")


@pytest.mark.parametrize(("stage", "done"), [(0, False), (1, True)])
def test_resume_is_bit_exact_in_and_between_stages(whole, stage, done):
    root, data, model = whole
    run = cut(root, stage, done)
    resumed = train(data, run, settings=TINY, checkpoint_seconds=0.0, log_every=2)
    for expected, found in zip(leaves(model), leaves(resumed), strict=True):
        np.testing.assert_array_equal(found, expected)
    steps = [json.loads(line)["step"] for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert steps == sorted(steps) and steps[-1] == 24


def test_a_finished_run_loads_without_its_data(whole):
    root, _, model = whole
    assert finished(root / "whole")
    loaded, config = load_run(root / "whole")
    for expected, found in zip(leaves(model), leaves(loaded), strict=True):
        np.testing.assert_array_equal(found, expected)
    assert config.scene["keypoints"] == ["disc"]


def test_another_seed_gives_other_weights_and_may_not_share_a_folder(whole, tmp_path):
    root, data, model = whole
    with pytest.raises(KeycldError, match="seed was 0, now 1"):
        train(data, root / "whole", settings=TINY, seed=1)


def test_a_half_written_checkpoint_is_not_used(tmp_path):
    save_checkpoint(tmp_path, "00-a-000001", {"w": np.arange(3.0)}, {"step": 1})
    half = tmp_path / "checkpoints" / ".00-a-000002.partial"
    half.mkdir()
    (half / "leaves.eqx").write_bytes(b"half")
    found = latest_checkpoint(tmp_path)
    assert found is not None and found.name == "00-a-000001"
    np.testing.assert_array_equal(load_leaves(found, {"w": np.zeros(3)})["w"], [0, 1, 2])


def test_a_truncated_checkpoint_is_named(tmp_path):
    path = save_checkpoint(tmp_path, "00-a-000001", {"w": np.arange(300.0)}, {"step": 1})
    data = (path / "leaves.eqx").read_bytes()
    (path / "leaves.eqx").write_bytes(data[: len(data) // 2])
    with pytest.raises(KeycldError, match="00-a-000001.*damaged"):
        load_leaves(path, {"w": np.zeros(300)})


def test_old_checkpoints_are_deleted_only_after_a_new_one(tmp_path):
    for k in range(4):
        save_checkpoint(tmp_path, f"00-a-{k:06d}", {"w": np.zeros(1)}, {"step": k}, keep=2)
    names = {p.name for p in (tmp_path / "checkpoints").iterdir() if p.is_dir()}
    assert names == {"00-a-000002", "00-a-000003"}


def test_an_unwritable_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(KeycldError, match="cannot write"):
        save_checkpoint(tmp_path / "file", "x", {}, {})
