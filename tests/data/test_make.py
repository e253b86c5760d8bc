"""Making data: complete, repeatable, resumed after a kill, refused where it would mix."""

import json
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from sample import assert_equal

from keycld import KeycldError
from keycld.data import check, make_data, open_data, read
from keycld.data.generate import job as job_module
from keycld.data.generate.parts import record
from keycld.data.generate.protocols import splits
from keycld.systems import get

# Small, but of two parts: one of 500 frames and a rest.
RUNS = {"train": 26, "validation": 2, "test": 2, "test_long": 2}
FRAMES = {"train": 20, "validation": 20, "test": 20, "test_long": 30}
TINY = {"runs": dict.fromkeys(RUNS, 1), "frames": dict.fromkeys(FRAMES, 4), "all": True, "workers": 1}
FILES = ("train", "validation", "test", "test_long", "sweeps")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A small pendulum set, made without interruption."""
    folder = tmp_path_factory.mktemp("data") / "pendulum"
    seen = []
    outcome = make_data("pendulum", folder, runs=RUNS, frames=FRAMES, all=True, progress=seen.append)
    return outcome, seen


def test_everything_is_there_and_sound(made):
    outcome, seen = made
    folder = outcome.folder
    assert check(folder) == []
    assert {path.name for path in folder.iterdir()} == {
        *(f"{name}.h5" for name in FILES), "README.md", "statistics.json", "preview.gif", ".lock",
    }  # fmt: skip
    assert outcome.fresh and outcome.frames == seen[-1].done == seen[-1].total == (26 + 2 + 2) * 20 + 2 * 30 + 80
    train = read(folder / "train.h5")
    assert train.image.shape == (26, 20, 64, 64, 3) and train.input.shape == (26, 1)
    assert train.attributes["system"] == "pendulum" and train.attributes["protocol"] == "keycld-2022"
    assert train.attributes["state_names"] == ("angle", "angular_velocity")


def test_runs_are_the_protocols(made):
    plan = {split.name: split for split in splits("keycld-2022", runs=RUNS, frames=FRAMES)}
    for name, first in {"train": 0, "validation": 450, "test": 500, "test_long": 1000}.items():
        found = read(made[0].folder / f"{name}.h5", images=False)
        np.testing.assert_array_equal(found.parameters["seed"], first + np.arange(RUNS[name]))
        run, _ = record(get("pendulum"), plan[name], first + 1)
        np.testing.assert_array_equal(found.state[1], run.state)
        np.testing.assert_array_equal(found.state_derivative[1], run.state_derivative)
        np.testing.assert_array_equal(found.input[1], run.input.astype(np.float32))
        np.testing.assert_array_equal(found.time, run.time)


def test_pictures_show_the_states(made):
    from keycld.systems import render

    test = read(made[0].folder / "test.h5")
    np.testing.assert_array_equal(render(get("pendulum"), test.state[1, 10:14]).image, test.image[1, 10:14])


def test_sweeps(made):
    rotation, grid = open_data(made[0].folder).sweeps()
    assert (rotation.name, rotation.vary, rotation.shape) == ("rotation", ("angle",), (64,))
    assert rotation.image.shape == (64, 64, 64, 3) and grid.image.shape == (16, 64, 64, 3)
    np.testing.assert_allclose(rotation.state[[0, -1], 0], [-np.pi, np.pi])
    np.testing.assert_array_equal(rotation.image[0], grid.image[0])
    assert check(made[0].folder / "sweeps.h5") == []


def test_statistics_say_what_the_definition_says(made):
    folder = made[0].folder
    figures = json.loads((folder / "statistics.json").read_text())
    image = read(folder / "validation.h5").image.astype(np.float64).reshape(-1, 64, 64, 3) / 255.0
    split = figures["splits"]["validation"]
    assert split["epsilon"] == pytest.approx(np.mean((image - image.mean(axis=0)) ** 2), rel=1e-5)
    assert split["mean"] == pytest.approx(image.mean(), rel=1e-5)
    assert split["deviation"] == pytest.approx(image.std(), rel=1e-5)
    state = read(folder / "validation.h5", images=False).state
    assert split["motion_per_frame"]["angle"]["largest"] == pytest.approx(np.abs(np.diff(state[..., 0])).max())
    assert figures["renderer"] == made[0].renderer


def test_the_card_names_the_essentials(made):
    card = (made[0].folder / "README.md").read_text()
    for word in ("# pendulum", "preview.gif", "26 × 20", "angle (rad)", "keycld-2022", made[0].renderer, "sin θ"):
        assert word in card


def test_finished_data_are_left_alone(made):
    folder = made[0].folder
    before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    again = make_data("pendulum", folder, runs=RUNS, frames=FRAMES)
    assert not again.fresh and again.frames == 0 and again.renderer == made[0].renderer
    assert {path: path.stat().st_mtime_ns for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"protocol": "keycld-2024"}, "another protocol and initial_state and input_limit and clip"),
        ({"control": "none"}, "another control:"),
        ({"runs": RUNS | {"train": 27}}, "another number of recordings:"),
        ({"frames": FRAMES | {"test_long": 70}}, "another number of frames:"),
    ],
)
def test_other_settings_do_not_mix_with_finished_data(made, changes, words):
    with pytest.raises(KeycldError, match=words):
        make_data("pendulum", made[0].folder, **{"runs": RUNS, "frames": FRAMES, **changes})


def test_another_system_does_not_mix(made):
    with pytest.raises(KeycldError, match="another system"):
        make_data("acrobot", made[0].folder, runs=RUNS, frames=FRAMES)


@pytest.mark.parametrize(("control", "acting"), [("none", ()), ("torque", ("torque",))])
def test_only_inputs_that_act_are_stored(tmp_path, control, acting):
    """The motion is that of the system with all its motors; in the long test all motors of the set are still."""
    make_data("cartpole", tmp_path, control=control, **TINY)
    assert check(tmp_path) == [] and open_data(tmp_path).input_names == acting
    plan = {split.name: split for split in splits("keycld-2022", control=control, frames=TINY["frames"])}
    system = get("cartpole")
    for name in FILES:
        found = read(tmp_path / f"{name}.h5", images=False)
        assert found.attributes["input_names"] == acting and found.input.shape == (len(found), len(acting))
        if name in ("test_long", "sweeps"):
            assert not np.any(found.input)
        if name == "sweeps":
            continue
        run, _ = record(system, plan[name], plan[name].seeds[0])
        np.testing.assert_array_equal(found.state[0], run.state)
        columns = [system.input_names.index(each) for each in acting]
        np.testing.assert_array_equal(found.input[0], run.input[columns].astype(np.float32))


def test_a_kill_at_any_moment_costs_one_part(made, tmp_path):
    folder = tmp_path / "pendulum"
    call = f"make_data('pendulum', {str(folder)!r}, runs={RUNS}, frames={FRAMES}, all=True, workers=1)"
    process = subprocess.Popen([sys.executable, "-c", f"from keycld.data import make_data; {call}"])
    deadline = time.monotonic() + 60
    while len(list(folder.glob(".partial/*-*.h5"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    # Nothing looks finished, and no part is half-written.
    assert not list(folder.glob("*.h5")) and "unfinished" in check(folder)[-1]
    done = list(folder.glob(".partial/*.h5"))
    assert done and all(check(part) == [] for part in done)
    with pytest.raises(KeycldError, match="another number of recordings"):
        make_data("pendulum", folder, runs=RUNS | {"train": 30}, frames=FRAMES)
    resumed = make_data("pendulum", folder, runs=RUNS, frames=FRAMES, all=True)
    assert 0 < resumed.frames < made[0].frames
    for name in FILES:
        assert_equal(read(folder / f"{name}.h5"), read(made[0].folder / f"{name}.h5"))
    assert not (folder / ".partial").exists()


def test_a_kill_while_joining_is_resumed_too(made, tmp_path, monkeypatch):
    folder = tmp_path / "pendulum"
    join = job_module.join

    def dies(parts, path):
        if path.name == "test.h5":
            raise KeyboardInterrupt
        join(parts, path)

    monkeypatch.setattr(job_module, "join", dies)
    with pytest.raises(KeyboardInterrupt):
        make_data("pendulum", folder, **TINY)
    with pytest.raises(KeycldError, match="unfinished"):
        open_data(folder)
    monkeypatch.setattr(job_module, "join", join)
    resumed = make_data("pendulum", folder, **TINY)
    assert resumed.fresh and resumed.frames == 0 and check(folder) == []


def test_data_of_before_a_setting_was_renamed_are_recognised(made, tmp_path):
    folder = shutil.copytree(made[0].folder, tmp_path / "data")
    path = folder / "statistics.json"
    path.write_text(path.read_text().replace('"initial_state"', '"start"'))
    assert not make_data("pendulum", folder, runs=RUNS, frames=FRAMES).fresh


def test_a_lost_file_is_missed(made, tmp_path):
    folder = tmp_path / "pendulum"
    shutil.copytree(made[0].folder, folder)
    (folder / "test.h5").unlink()

    def stop(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_data("pendulum", folder, runs=RUNS, frames=FRAMES, progress=stop)
    assert (folder / ".partial").exists() and "unfinished" in " ".join(check(folder))


def test_bad_folders(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(KeycldError, match="choose a folder that you may write to"):
        make_data("pendulum", tmp_path / "file" / "data")
    (tmp_path / "train.h5").write_text("mine")
    with pytest.raises(KeycldError, match="already holds train.h5 from elsewhere"):
        make_data("pendulum", tmp_path)
    assert (tmp_path / "train.h5").read_text() == "mine"


def test_bad_names(tmp_path):
    with pytest.raises(KeycldError, match="did you mean 'pendulum'"):
        make_data("pendulm", tmp_path)
    with pytest.raises(KeycldError, match="control mode"):
        make_data("pendulum", tmp_path / "a", control="half")
    assert not (tmp_path / "a").exists()


def test_without_gl_nothing_is_lost(tmp_path, monkeypatch):
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent")
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    with pytest.raises(KeycldError, match="libegl1"):
        make_data("pendulum", tmp_path / "a", **TINY)
    assert [path.name for path in (tmp_path / "a").rglob("*.json")] == ["recipe.json"]
    assert not list((tmp_path / "a").rglob("*.h5"))
