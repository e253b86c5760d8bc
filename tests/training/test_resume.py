"""A run that was cut anywhere ends with the same bits as one that was not."""

import json
import shutil

import jax
import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld._lock import locked
from keycld.data import open_data, resident
from keycld.training import finished, load_run, train
from keycld.training.checkpoints import latest_checkpoint, load_leaves, save_checkpoint
from keycld.training.presets import FastRecipe
from keycld.training.presets.prepare import cache_keypoints, fit_dynamics, measure_beginning, share_constants
from scenes import TINY


@pytest.fixture(scope="module")
def whole(tmp_path_factory, trained):
    root = shutil.copytree(trained, tmp_path_factory.mktemp("resume"), dirs_exist_ok=True)
    return root, root / "mine", load_run(root / "whole")[0]


def assert_same(expected, found):
    for one, other in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        np.testing.assert_array_equal(other, one)


def steps(run):
    return [json.loads(line)["step"] for line in (run / "metrics.jsonl").read_text().splitlines()]


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


@pytest.mark.parametrize(
    ("done", "last", "logged"), [(False, "00-vision-000006", [4, 6]), (True, "01-dynamics-000006", [4, 6, 8, 10, 12])]
)
def test_resume_within_and_after_a_stage_is_bit_exact(whole, monkeypatch, capsys, done, last, logged):
    """To the end of that stage, or of the next one, whose checkpoint the uninterrupted run has kept."""
    root, data, _ = whole
    stages, count = FastRecipe.stages, 1 + done
    monkeypatch.setattr(FastRecipe, "stages", lambda *arguments: stages(*arguments)[:count])
    run = cut(root, 0, done)
    resumed = train(data, run, settings=TINY, checkpoint_seconds=0.0, log_every=2)
    (expected,) = load_leaves(root / "whole" / "checkpoints" / last, (resumed,))
    assert_same(expected, resumed)
    assert steps(run) == logged
    # Six steps teach nobody to see, and who waits is told at the end of that stage.
    assert ("the keypoints have not found their parts" in capsys.readouterr().err) == (not done)


def test_a_finished_run_loads_without_its_data(whole):
    root, _, model = whole
    assert finished(root / "whole")
    loaded, config = load_run(root / "whole")
    assert_same(model, loaded)
    assert config.scene["keypoints"] == ["disc"]


def test_a_run_with_settings_of_an_older_recipe_still_loads(whole):
    root, _, model = whole
    old = shutil.copytree(root / "whole", root / "old")
    config = json.loads((old / "config.json").read_text())
    config["settings"]["no_longer_there"] = 6
    (old / "config.json").write_text(json.dumps(config))
    assert_same(model, load_run(old)[0])


def test_another_seed_gives_other_weights_and_may_not_share_a_folder(whole, tmp_path):
    root, data, model = whole
    with pytest.raises(KeycldError, match="seed was 0, now 1"):
        train(data, root / "whole", settings=TINY, seed=1)
    with pytest.raises(KeycldError, match="settings.joint_rate was .*, now 0.5"):
        train(data, root / "whole", settings=TINY | {"joint_rate": 0.5})


def test_the_control_preset_ends_with_a_fit_of_the_dynamics_alone(whole, tmp_path):
    """A finished run of `fast` goes on with it."""
    root, data, before = whole
    run = shutil.copytree(root / "whole", tmp_path / "run")
    config = json.loads((run / "config.json").read_text())
    config |= {"preset": "control", "settings": config["settings"] | {"last_fit": 6}}
    (run / "config.json").write_text(json.dumps(config))
    after = train(data, run, preset="control", settings=TINY | {"last_fit": 6})
    assert_same((before.estimator, before.renderer), (after.estimator, after.renderer))
    _, cached = cache_keypoints(before, resident(open_data(data).train()))
    prepared, _ = share_constants(before, cached)
    expected, _ = measure_beginning(*fit_dynamics(prepared, cached, trajectories=6))
    assert_same(expected, after)
    assert (run / "checkpoints" / "latest").read_text().startswith("05-fit") and finished(run)


def test_two_processes_do_not_train_in_one_folder(whole, tmp_path):
    root, data, _ = whole
    run = shutil.copytree(root / "whole", tmp_path / "run")
    # A lock belongs to an open file, not to a process, so this one may stand for another.
    with locked(run / ".lock"), pytest.raises(KeycldError, match="another process is training in .*run"):
        train(data, run, settings=TINY)


def test_what_the_recipe_refuses_leaves_no_folder(whole, tmp_path):
    _, data, _ = whole
    for refused in ({"width": 12}, {"given": 1}):
        with pytest.raises(KeycldError):
            train(data, tmp_path / "run", settings=TINY | refused)
    assert not (tmp_path / "run").exists()


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
