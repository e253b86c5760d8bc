"""A run that is killed at any moment and resumed gives the same bits as an uninterrupted one."""

import dataclasses
import json
import re
import shutil

import equinox as eqx
import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld._lock import locked
from keycld.data import open_data
from keycld.mechanics import terms_of, with_kinds, with_terms
from keycld.models import Scene, config_for
from keycld.models.keycld import identify
from keycld.models.keycld.prepare_dynamics import fit_dynamics
from keycld.models.keycld.prepare_priors import measure_velocity_prior
from keycld.models.keycld.recipes.fast import FastConfig
from keycld.stages import AbstractLoss
from keycld.training import finished, load_run, loop, runs, train
from keycld.training.checkpoints import (
    STATE,
    WEIGHTS,
    latest_checkpoint,
    load_arrays,
    named_arrays,
    save_arrays,
    save_checkpoint,
)
from keycld.training.run_files import read_config
from scenes import TINY, write_data

CONFIG = config_for("keycld", "fast", **TINY)


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
    """Copy the run as a kill after a checkpoint within, or at the end of, a stage would leave it."""
    copy = root / f"cut-{stage}-{done}"
    shutil.copytree(root / "whole", copy)
    checkpoints = sorted(path for path in (copy / "checkpoints").iterdir() if path.is_dir())
    positions = [json.loads((path / "position.json").read_text()) for path in checkpoints]
    last = [(position["stage"], position["done"]) for position in positions].index((stage, done))
    for later in checkpoints[last + 1 :]:
        shutil.rmtree(later)
    (copy / "checkpoints" / "latest").write_text(checkpoints[last].name)
    return copy


def test_a_profile_is_written_for_each_stage_and_changes_nothing(whole):
    root, data, expected = whole
    profiled = shutil.copytree(root / "whole", root / "profiled")
    shutil.rmtree(profiled / "checkpoints")
    (profiled / "metrics.jsonl").unlink()
    assert_same(expected, train(data, profiled, CONFIG, log_every=2, profile=True))
    traces = {path.relative_to(profiled / "profile").parts[0] for path in profiled.rglob("perfetto_trace.json.gz")}
    assert traces == {"vision", "joint"}


@pytest.mark.parametrize(
    ("done", "last", "logged"), [(False, "00-vision-000006", [4, 6]), (True, "01-dynamics-000000", [4, 6])]
)
def test_resume_within_and_after_a_stage_is_bit_exact(whole, monkeypatch, done, last, logged):
    """To the end of that stage, or of the next one, whose checkpoint the uninterrupted run has kept."""
    root, data, _ = whole
    stages, count = FastConfig.stages, 1 + done
    monkeypatch.setattr(FastConfig, "stages", lambda *arguments: stages(*arguments)[:count])
    run = cut(root, 0, done)
    resumed = train(data, run, CONFIG, checkpoint_seconds=0.0, log_every=2)
    expected = load_arrays(root / "whole" / "checkpoints" / last / WEIGHTS, resumed)
    assert_same(expected, resumed)
    assert steps(run) == logged


def test_a_stage_on_training_and_validation_takes_all_steps_and_is_resumed_on_both(tmp_path, monkeypatch):
    stages = FastConfig.stages
    monkeypatch.setattr(
        FastConfig, "stages", lambda *given: (dataclasses.replace(stages(*given)[0], with_validation=True),)
    )
    data = write_data(tmp_path / "mine")
    for name in ("train", "validation", "test"):
        with h5py.File(data / f"{name}.h5", "r+") as file:
            file.attrs["protocol"] = "clip"
    taken, make_step = [], loop.make_step

    def watched(*given, **named):
        run = make_step(*given, **named)
        return lambda fixed, progress: (taken.append(fixed[1].shape), run(fixed, progress))[1]

    monkeypatch.setattr(loop, "make_step", watched)
    expected = train(data, tmp_path / "whole", CONFIG, checkpoint_seconds=0.0, log_every=2, keep=100)
    assert set(taken) == {(6, 24, 16, 16, 3)}
    assert_same(expected, train(data, cut(tmp_path, 0, False), CONFIG, log_every=2))
    assert set(taken) == {(6, 24, 16, 16, 3)}


def test_resume_at_a_fit_between_steps_is_bit_exact(whole):
    root, data, expected = whole
    assert_same(expected, train(data, cut(root, 2, False), CONFIG, log_every=2))


def test_a_stage_without_steps_that_is_repeated_is_logged_once(whole):
    """Killed after the validation score of the last stage, and before its checkpoint."""
    root, data, _ = whole
    run = cut(root, 2, True)
    before = steps(run)
    train(data, run, CONFIG, log_every=2)
    assert steps(run) == before


def test_a_stage_that_fails_begins_again_with_other_weights_three_times_at_most(whole, tmp_path, capsys):
    """After six steps the keypoints have not found their parts."""
    _, data, _ = whole
    with pytest.raises(
        KeycldError, match="failed 3 times .*, the last time in stage vision: the keypoints have not found"
    ):
        train(data, tmp_path / "run", CONFIG.changed({"vision.worst": 0.01, "vision.candidates": 1}), log_every=2)
    printed = capsys.readouterr()
    assert printed.err.count("restart ") == 2
    losses = set(re.findall(r"6/6 .* loss (\S+)", printed.out + printed.err))
    verdict = json.loads((tmp_path / "run" / "verdict.json").read_text())
    assert not verdict["passed"] and len(verdict["failures"]) == len(losses) == 3
    with pytest.raises(KeycldError, match="there is no model in .* failed 3 times .* in stage vision"):
        load_run(tmp_path / "run")


class Infinite(AbstractLoss):
    def __call__(self, model, clips, *, key, step):
        return jnp.inf * jnp.mean(model.renderer.background), {}


@pytest.mark.parametrize(
    ("skips", "message"),
    [
        (2, r"failed 3 times .* stage vision: not a finite .* step 2: .* 2 such"),
        (0, "stage 'vision': not a finite .* step 0: .* checkpoint is intact"),
    ],
)
def test_a_stage_that_may_skip_steps_begins_again_after_too_many(whole, tmp_path, monkeypatch, skips, message):
    """Other weights may pass; a training without such a stage may be of days, and is not thrown away."""
    _, data, _ = whole
    stages = FastConfig.stages

    def infinite(*arguments):
        return (dataclasses.replace(stages(*arguments)[0], loss=Infinite(), skips=skips, candidates=1),)

    monkeypatch.setattr(FastConfig, "stages", infinite)
    with pytest.raises(KeycldError, match=message):
        train(data, tmp_path / "run", CONFIG, log_every=2)
    verdict = tmp_path / "run" / "verdict.json"
    assert len(json.loads(verdict.read_text())["failures"]) == 3 if skips else not verdict.exists()


@pytest.mark.slow
def test_a_stage_as_short_as_the_trials_of_its_candidates_is_judged(whole, tmp_path, monkeypatch):
    # One program for the five steps of a trial and the one that is left.
    monkeypatch.setattr(loop, "STEPS_PER_DISPATCH", 1)
    _, data, _ = whole
    with pytest.raises(KeycldError, match="the last time in stage vision: the keypoints have not found"):
        train(data, tmp_path / "run", CONFIG.changed({"vision.worst": 0.01, "vision.trial": 6}), log_every=2)


def test_a_run_that_began_again_is_resumed_bit_for_bit(whole, tmp_path, monkeypatch):
    _, data, _ = whole
    stages, left = FastConfig.stages, [True]

    def fail_at_first(*arguments):
        first = stages(*arguments)[0]

        def judge(model, data):
            return "on purpose." if left and left.pop() else None

        return (dataclasses.replace(first, judge=judge),)

    monkeypatch.setattr(FastConfig, "stages", fail_at_first)
    run = tmp_path / "run"
    expected = train(data, run, CONFIG, checkpoint_seconds=0.0, log_every=2, keep=100)
    assert json.loads((run / "verdict.json").read_text()) == {"passed": True, "failures": ["vision: on purpose."]}
    (run / "checkpoints" / "latest").write_text("again1-00-vision-000004")
    assert_same(expected, train(data, run, CONFIG, log_every=2))
    assert steps(run) == [4, 6]  # as an uninterrupted one: the first two are the trial of the candidates


def test_a_run_that_is_killed_after_it_began_again_keeps_no_lines_of_that_attempt(whole, tmp_path, monkeypatch):
    """It continues from a checkpoint of the attempt before, and may pass there on another device."""
    _, data, _ = whole
    stages, save, failing = FastConfig.stages, loop.save_checkpoint, [True]

    def first_stage(*arguments):
        return (dataclasses.replace(stages(*arguments)[0], judge=lambda *_: "on purpose." if failing else None),)

    def killed(folder, name, *arguments):
        if name.startswith("again"):
            raise KeyboardInterrupt
        return save(folder, name, *arguments)

    monkeypatch.setattr(FastConfig, "stages", first_stage)
    monkeypatch.setattr(loop, "save_checkpoint", killed)
    run = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        train(data, run, CONFIG, checkpoint_seconds=0.0, log_every=2)
    assert steps(run) == [4]
    failing.clear()
    train(data, run, CONFIG, log_every=2)
    assert steps(run) == [6]


def test_the_steps_of_a_dashboard_never_fall(whole, tmp_path, monkeypatch):
    """wandb and trackio drop steps that they have passed, here those of the second and third attempt."""
    _, data, _ = whole
    logged = []

    class Dashboard:
        def log(self, step, values):
            logged.append(step)

        def close(self):
            pass

    monkeypatch.setattr(runs, "make_tracker", lambda *_: Dashboard())
    stages = FastConfig.stages
    monkeypatch.setattr(
        FastConfig, "stages", lambda *a: (dataclasses.replace(stages(*a)[0], judge=lambda *_: "on purpose."),)
    )
    with pytest.raises(KeycldError, match="failed 3 times"):
        train(data, tmp_path / "run", CONFIG, log_every=2)
    assert logged == [4, 6, 10, 12, 16, 18]


def test_what_a_kill_left_of_older_checkpoints_is_deleted(whole):
    """A process that ended while it deleted them, after the last one: a finished run writes no further one."""
    root, data, expected = whole
    run = shutil.copytree(root / "whole", root / "full")
    assert len([path for path in (run / "checkpoints").iterdir() if path.is_dir()]) > 2
    assert_same(expected, train(data, run, CONFIG, log_every=2))
    left = {path.name for path in (run / "checkpoints").iterdir() if path.is_dir()}
    assert len(left) == 2 and latest_checkpoint(run).name in left


@pytest.mark.parametrize("gone", [WEIGHTS, "position.json"])
def test_a_checkpoint_that_a_kill_has_deleted_in_part_is_the_oldest(tmp_path, gone):
    for number in range(3):
        save_checkpoint(tmp_path, f"00-a-{number}", {"w": np.ones(3, "f4")}, {}, {"step": number}, keep=3)
    (tmp_path / "checkpoints" / "00-a-0" / gone).unlink()  # this makes its folder the newest
    save_checkpoint(tmp_path, "00-a-2", {"w": np.ones(3, "f4")}, {}, {"step": 2}, keep=2)
    assert {path.name for path in (tmp_path / "checkpoints").iterdir()} == {"00-a-1", "00-a-2", "latest"}


def test_a_finished_run_loads_without_its_data(whole):
    root, _, model = whole
    assert finished(root / "whole")
    loaded, config = load_run(root / "whole")
    assert_same(model, loaded)
    assert config.scene["inputs"] == 1 and "disc" in config.settings["constraints"]


def test_a_configuration_of_schema_1_is_migrated(whole):
    """Flat settings, constraints and keypoints outside of them, perceptrons in V and g, two joint stages."""
    root, _, _ = whole
    old = shutil.copytree(root / "whole", root / "old")
    config = json.loads((old / "config.json").read_text())
    then = CONFIG.changed(
        {"constraints": config["settings"]["constraints"], "terms": ["perceptron-32"], "input_width": 32}
    )
    model = then.build(Scene(**config["scene"]), jax.random.key(1))
    checkpoint = latest_checkpoint(old)
    save_arrays(checkpoint / WEIGHTS, model)
    position = json.loads((checkpoint / "position.json").read_text())
    (checkpoint / "position.json").write_text(json.dumps(position | {"changes": {}}))
    settings = config["settings"]
    flat = {"width": 8, "begin": 0.5, "vision_steps": 6, "joint_horizons": [6, 8], "joint_rate": 2e-3, "groups": 2}
    config |= {
        "settings": flat | {"vision_batch": 4, "candidates": 2, "trial": 2, "long_steps": 0},
        "constraints": settings["constraints"],
        "dt": config["scene"].pop("dt"),
        "moved_inputs": [True],
    }
    config["scene"]["keypoints"] = ["disc"]
    for name in ("schema_version", "input_names", "epsilon"):
        del config[name]
    (old / "config.json").write_text(json.dumps(config))
    loaded, now = load_run(old)
    assert_same(model, loaded)
    assert (
        now.settings["vision"] == settings["vision"] | {"worst": 0.2, "patches": [0.0, 0.0]}
        and now.settings["joint"]["rate"] == 2e-3
    )
    assert now.settings["joint"]["steps"] == 2000 and now.scene["dt"] == 0.05


def test_a_configuration_of_schema_2_is_migrated(whole):
    """Two joint stages become one, with the preset's own steps and horizons."""
    root, _, _ = whole
    old = shutil.copytree(root / "whole", root / "second")
    config = json.loads((old / "config.json").read_text())
    config["schema_version"] = 2
    config["settings"] |= {"long": config["settings"]["joint"] | {"steps": 3600}}
    for name in ("terms", "input_width"):
        del config["settings"][name]
    config["settings"]["joint"] |= {"scale": 0.02}
    del config["settings"]["joint"]["fit_every"]
    (old / "config.json").write_text(json.dumps(config))
    settings = read_config(old).settings
    assert settings["terms"] == ["perceptron-32"] and settings["input_width"] == 32 and "long" not in settings
    assert settings["joint"] == CONFIG.changed({"joint.steps": 2000}).settings()["joint"] | {
        "scale": 0.02,
        "horizons": [8, 16, 32, 50, 50],
        "fit_every": 400,
    }


@pytest.mark.parametrize("preset", ["fast", "clip"])
def test_a_configuration_of_schema_4_is_migrated(whole, preset):
    """Patches counted in clips alone, by settings outside of the stage."""
    root, _, _ = whole
    old = shutil.copytree(root / "whole", root / f"fourth-{preset}")
    config = json.loads((old / "config.json").read_text())
    settings = config_for("keycld", preset, constraints=config["settings"]["constraints"]).settings()
    for name in ("patches", "patch", "spread"):
        del settings["vision"][name]
    of_clips = {"rigid": 1.5, "patch": 0.05} if preset == "clip" else {}
    config |= {"schema_version": 4, "preset": preset, "settings": settings | of_clips}
    (old / "config.json").write_text(json.dumps(config))
    vision = read_config(old).settings["vision"]
    assert (vision["patches"], vision["patch"]) == (([1.5, 1.5], 0.05) if preset == "clip" else ([0.0, 0.0], 0.06))
    assert vision["spread"] == 0.1


def test_a_latent_model_of_schema_5_was_not_compared_with_its_encoder():
    """`fast` did not have this term, which it has by default now."""
    config = config_for("hgn", "fast")
    old = {name: value for name, value in config.settings().items() if name != "consistency"}
    assert config.consistency > 0
    assert config.changed(config.migrated(old, 5)).consistency == 0
    assert config.changed(config.migrated(config.settings(), 6)).consistency == config.consistency


def test_a_latent_model_of_schema_7_learned_pictures_from_motions():
    """`fast` had no stage for pictures."""
    config = config_for("hgn", "fast")
    old = {name: value for name, value in config.settings().items() if not name.startswith("pictures")}
    names = [stage.name for stage in config.changed(config.migrated(old, 7)).stages(Scene(32, 32, 0, 256, 0.05, 100))]
    assert names == ["horizon-8", "horizon-24", "horizon-all"]
    assert config.migrated(config.settings(), 8) == config.settings()


@pytest.mark.slow
def test_a_model_that_grew_is_resumed_and_loaded(whole, monkeypatch):
    """With springs that the settings do not name: the checkpoint does."""
    # Nothing is dropped at the end.
    monkeypatch.setattr(identify, "select_terms", lambda fitted, dt, tried: (fitted.dynamics, {}))
    root, data, _ = whole
    run = cut(root, 1, True)
    checkpoint = latest_checkpoint(run)
    model = load_run(run)[0]
    springs = with_kinds(with_terms(model.law, {}), ("springs",), key=jax.random.key(0))
    grown = eqx.tree_at(lambda m: m.dynamics.law, model, springs)
    save_arrays(checkpoint / WEIGHTS, grown)
    position = json.loads((checkpoint / "position.json").read_text())
    (checkpoint / "position.json").write_text(json.dumps(position | {"changes": {"terms": ["springs"]}}))
    resumed = train(data, run, CONFIG, log_every=2)
    assert set(terms_of(resumed.law)) == {"springs"} and finished(run)
    loaded, config = load_run(run)
    assert_same(resumed, loaded)
    assert config.settings["terms"] == ["viscous"]


def test_a_renamed_field_is_a_migration_and_not_damage(tmp_path):
    save_arrays(
        tmp_path / "w.safetensors", {"start": {"constants": np.arange(2.0, dtype="f4")}, "dynamics": np.ones((), "f4")}
    )
    like = {"initial_state": {"constants": np.zeros(2, "f4")}, "dynamics": np.zeros((), "f4")}
    found = load_arrays(tmp_path / "w.safetensors", like, {"start.": "initial_state."})
    np.testing.assert_array_equal(found["initial_state"]["constants"], [0, 1])
    with pytest.raises(KeycldError, match="'initial_state.constants' is missing"):
        load_arrays(tmp_path / "w.safetensors", like)
    with pytest.raises(KeycldError, match=r"has the shape \[2\], not \[3\]"):
        load_arrays(
            tmp_path / "w.safetensors", {"start": {"constants": np.zeros(3, "f4")}, "dynamics": np.zeros((), "f4")}
        )


@pytest.mark.parametrize(
    ("version", "words"),
    [(99, "schema_version 99 is later than"), ("x", "'schema_version' is 'x', but must be a whole number")],
)
def test_a_later_schema_is_refused(whole, tmp_path, version, words):
    root, _, _ = whole
    run = shutil.copytree(root / "whole", tmp_path / "later")
    config = json.loads((run / "config.json").read_text())
    (run / "config.json").write_text(json.dumps(config | {"schema_version": version}))
    with pytest.raises(KeycldError, match=words):
        load_run(run)


def test_another_seed_gives_other_weights_and_may_not_share_a_folder(whole, tmp_path):
    root, data, model = whole
    with pytest.raises(KeycldError, match="seed was 0, now 1"):
        train(data, root / "whole", CONFIG, seed=1)
    with pytest.raises(KeycldError, match="settings.joint.rate was 0.002, now 0.5"):
        train(data, root / "whole", CONFIG.changed({"joint.rate": 0.5}))


def test_the_control_preset_ends_as_fast_does_with_a_fit_to_more_recordings(whole, capsys):
    root, data, before = whole
    config = config_for("keycld", "control", **TINY, last_fit=6).completed(open_data(data))
    last = config.stages(Scene(**read_config(root / "whole").scene))[-1]
    resident = open_data(data).resident()
    expected, _ = measure_velocity_prior(*fit_dynamics(before, resident, trajectories=6))
    assert_same(expected, last.prepare(before, resident)[0])
    assert "light        discs are" in capsys.readouterr().out


def test_two_processes_do_not_train_in_one_folder(whole, tmp_path):
    root, data, _ = whole
    run = shutil.copytree(root / "whole", tmp_path / "run")
    # A lock belongs to an open file, not to a process, so this one may stand for another.
    with locked(run / ".lock"), pytest.raises(KeycldError, match="another process is training in .*run"):
        train(data, run, CONFIG)


def test_what_the_recipe_refuses_leaves_no_folder(whole, tmp_path):
    _, data, _ = whole
    for refused in ({"width": 12}, {"given": 1}):
        with pytest.raises(KeycldError):
            train(data, tmp_path / "run", config_for("keycld", "fast", **TINY | refused))
    assert not (tmp_path / "run").exists()


def test_a_half_written_checkpoint_is_not_used(tmp_path):
    save_checkpoint(tmp_path, "00-a-000001", {"w": np.arange(3, dtype="f4")}, {"m": np.ones(2, "f4")}, {"step": 1})
    half = tmp_path / "checkpoints" / ".00-a-000002.partial"
    half.mkdir()
    (half / WEIGHTS).write_bytes(b"half")
    found = latest_checkpoint(tmp_path)
    assert found is not None and found.name == "00-a-000001"
    np.testing.assert_array_equal(load_arrays(found / WEIGHTS, {"w": np.zeros(3, "f4")})["w"], [0, 1, 2])
    np.testing.assert_array_equal(load_arrays(found / STATE, {"m": np.zeros(2, "f4")})["m"], [1, 1])


def test_a_truncated_checkpoint_is_named(tmp_path):
    path = save_checkpoint(tmp_path, "00-a-000001", {"w": np.arange(300.0)}, {}, {"step": 1})
    data = (path / WEIGHTS).read_bytes()
    (path / WEIGHTS).write_bytes(data[: len(data) // 2])
    with pytest.raises(KeycldError, match="00-a-000001.*damaged"):
        load_arrays(path / WEIGHTS, {"w": np.zeros(300, "f4")})


def test_arrays_of_every_kind_come_back_as_they_were(tmp_path):
    tree = {
        "scalar": np.array(2.5, "f4"),
        "empty": np.zeros((0, 3), "f4"),
        "bits": np.array([True, False]),
        "n": np.array(7, "i4"),
    }
    save_arrays(tmp_path / "a.safetensors", {**tree, "none": None, "function": np.sin})
    found = load_arrays(tmp_path / "a.safetensors", {k: np.zeros_like(v) for k, v in tree.items()})
    for name, value in named_arrays(tree).items():
        np.testing.assert_array_equal(found[name], value)
        assert found[name].shape == value.shape


def test_old_checkpoints_are_deleted_only_after_a_new_one(tmp_path):
    for k in range(4):
        save_checkpoint(tmp_path, f"00-a-{k:06d}", {"w": np.zeros(1)}, {}, {"step": k}, keep=2)
    names = {p.name for p in (tmp_path / "checkpoints").iterdir() if p.is_dir()}
    assert names == {"00-a-000002", "00-a-000003"}


def test_an_unwritable_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(KeycldError, match="cannot write"):
        save_checkpoint(tmp_path / "file", "x", {}, {}, {})
