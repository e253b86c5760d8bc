"""The whole path through the real command line, on a tiny data set of our own: train, kill, resume, eval, predict."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

from keycld.cli.main import main
from keycld.training import run_folder
from scenes import TINY, write_data


def flags(settings, prefix="--"):
    """Settings as the flags of a command line: --vision.steps 6."""
    words = []
    for name, value in settings.items():
        if isinstance(value, dict):
            words += flags(value, f"{prefix}{name}.")
        else:
            words += [f"{prefix}{name}", *map(str, value if isinstance(value, list) else [value])]
    return words


SETTINGS = flags(TINY)


def keycld(*arguments, folder):
    command = [sys.executable, "-m", "keycld.cli.main", *map(str, arguments)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture
def here(monkeypatch, capsys):
    """The same without a new process, for the many mistakes: exit code and stderr."""

    def run(*arguments, folder):
        monkeypatch.chdir(folder)
        code = main([str(argument) for argument in arguments])
        return code, capsys.readouterr().err

    return run


def weights(run):
    name = (run / "checkpoints" / "latest").read_text()
    return (run / "checkpoints" / name / "weights.safetensors").read_bytes()


@pytest.fixture(scope="module")
def place(tmp_path_factory, trained):
    return shutil.copytree(trained, tmp_path_factory.mktemp("pipeline"), dirs_exist_ok=True)


@pytest.mark.parametrize(
    ("words", "doing"),
    [
        (["predict", "begun", "--data", "none.h5", "--out", "p.h5"], "predicting with"),
        (["control", "begun"], "controlling with"),
        (["export", "begun", "--to", "csv", "--split", "none"], "exporting"),
    ],
)
def test_verbs_say_that_a_training_is_not_finished(here, place, tmp_path, words, doing):
    run = shutil.copytree(place / "whole", tmp_path / "begun")
    (run / "checkpoints" / "latest").write_text("00-vision-000004")
    _, message = here(*words, folder=tmp_path)
    assert f"the training of begun is not finished; {doing} its newest checkpoint" in message


@pytest.mark.slow
def test_a_killed_training_ends_with_the_bits_of_one_that_was_not(here, place):
    """kill -9 as soon as there is a checkpoint in the middle of the last stage; the same command resumes.

    The run is resumed at the end of the stage before, as if it had been killed there too.
    """
    shutil.copytree(place / "whole", place / "cut")
    latest = place / "cut" / "checkpoints" / "latest"
    latest.write_text("01-dynamics-000000")
    for later in latest.parent.glob("02-joint-*"):
        shutil.rmtree(later)
    arguments = ["train", "--config", "whole/config.json", "--out", "cut", "--log-every", "2"]
    arguments += ["--checkpoint-seconds", "0"]
    command = [sys.executable, "-m", "keycld.cli.main", *arguments]
    process = subprocess.Popen(command, cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 300
    while not latest.read_text().startswith("02-joint-000002"):
        assert process.poll() is None, "the training ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.005)  # the next checkpoint is a training step and a written file away
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    code, message = here(*arguments, folder=place)
    assert code == 0, message
    assert weights(place / "cut") == weights(place / "whole")


def test_eval_predict_and_report(here, place):
    answer = keycld("eval", "whole", folder=place)
    assert answer.returncode == 0, answer.stderr
    assert "test@12" in answer.stderr and "72/72" in answer.stderr
    assert "mean image" in answer.stdout  # a trivial baseline next to every result
    scores = [json.loads(p.read_text()) for p in (place / "whole" / "evaluation").glob("*.json")]
    assert any(0 <= s["vpt"]["1"]["mean"] <= 1 for s in scores if "vpt" in s)

    shutil.copytree(place / "mine", place / "other")
    with h5py.File(place / "other" / "train.h5", "a") as file:
        file.attrs["generator"] = "another"
    before = {path.name: path.read_bytes() for path in (place / "whole" / "evaluation").iterdir()}
    code, message = here("eval", "whole", "--data", "other", folder=place)
    assert code == 0, message
    after = {path.name: path.read_bytes() for path in (place / "whole" / "evaluation").iterdir()}
    assert before.items() <= after.items() and "test@12-other.json" in after

    code, message = here("predict", "whole", "--data", "mine/test.h5", "--out", "predictions.h5", folder=place)
    assert code == 0, message
    assert "predict" in message and "72/72" in message and "left" in message
    with h5py.File(place / "predictions.h5") as file:
        assert file["image"].shape == (6, 12, 16, 16, 3) and file["image"].dtype == np.float32
        assert file["keypoints"].shape == (6, 12, 1, 2)
        assert np.isfinite(file["image"][:]).all()

    code, message = here("report", "whole", folder=place)
    assert code == 0, message
    page = (place / "whole" / "report.html").read_text()
    assert "</html>" in page and 'src="http' not in page


def test_a_control_result_of_a_packaged_model_does_not_replace_its_evaluation(here, tmp_path, monkeypatch):
    """A packaged model that was only controlled is evaluated before its page is written."""
    done = []
    monkeypatch.setattr("keycld.cli.evaluate.evaluate", done.append)
    monkeypatch.setattr("keycld.reports.write_report", lambda folder: folder / "report.html")
    monkeypatch.chdir(tmp_path)
    results = run_folder("pendulum") / "evaluation"
    results.mkdir()
    (results / "control-upright.json").write_text("{}")
    assert here("report", "pendulum", folder=tmp_path)[0] == 0 and done == ["pendulum"]
    (results / "sweeps.json").write_text("{}")
    assert here("report", "pendulum", folder=tmp_path)[0] == 0 and done == ["pendulum"]


def test_predictions_use_only_the_given_frames_and_inputs(here, place):
    """Later frames and true states replaced by noise: the same predictions, bit for bit."""
    with h5py.File(place / "mine" / "test.h5") as source, h5py.File(place / "noise.h5", "w") as target:
        for name in source:
            source.copy(name, target)
        target.attrs.update(source.attrs)
        random = np.random.default_rng(0)
        target["image"][:, 2:] = random.integers(0, 255, target["image"][:, 2:].shape, dtype=np.uint8)
        target["state"][:] = random.normal(size=target["state"].shape)
    for name in ("mine/test.h5", "noise.h5"):
        out = "from-" + name.replace("/", "-")
        code, message = here("predict", "whole", "--data", name, "--out", out, folder=place)
        assert code == 0, message
    with h5py.File(place / "from-mine-test.h5") as first, h5py.File(place / "from-noise.h5") as second:
        np.testing.assert_array_equal(first["image"][:], second["image"][:])


def truncated(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def without(name):
    def change(path):
        with h5py.File(path, "a") as file:
            del file[name]

    return change


def with_nan(name):
    def change(path):
        with h5py.File(path, "a") as file:
            values = file[name][:]
            values.flat[-1] = np.nan
            file[name][...] = values

    return change


def wrong_shape(path):
    with h5py.File(path, "a") as file:
        image = file["image"][:, :, :, :, :2]
        del file["image"]
        file["image"] = image


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (truncated, ["train.h5"]),
        (without("image"), ["image"]),
        (without("input"), ["input"]),
        (wrong_shape, ["image", "3"]),
        (with_nan("input"), ["input"]),
        (with_nan("time"), ["time"]),
        (with_nan("state"), ["state"]),
    ],
)
def test_bad_data_gets_one_sentence_and_code_two(here, tmp_path, change, words):
    folder = write_data(tmp_path / "bad", count=3, frames=10)
    change(folder / "train.h5")
    code, message = here("train", "bad", "--out", "run", folder=tmp_path)
    assert code == 2 and message.startswith("keycld: ") and len(message.strip().splitlines()) == 1, message
    assert all(word in message for word in words), message
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["train", "pendulm"], ["did you mean 'pendulum'"]),
        (["train", "mine", "--preset", "fsat"], ["did you mean 'fast'"]),
        (["train", "mine", "--model", "keycd"], ["did you mean 'keycld'"]),
        (["train", "mine", "--model", "keycld", "--model", "hgnn"], ["did you mean 'hgn'"]),
        (["train", "mine", "--out", "./mine", *SETTINGS], ["mine holds the data: choose another --out for the run."]),
        (["train", "--config", "whole/config.json", "--devices", "0"], ["not 0"]),
        (["train", "mine", "--vision.steps", "-3"], ["vision.steps is a finite number of at least 0, not -3"]),
        (["train", "mine", "--track", "wandbb"], ["did you mean 'wandb'"]),
        (["train", "mine", "--constraints", "none.toml"], ["none.toml"]),
        (["train", "mine", "--out", "file/run", *SETTINGS], ["cannot write"]),
        (["train"], ["name what to train on"]),
        (["train", "mine", "--checkpoint-seconds", "-1"], ["--checkpoint-seconds is a number of at least 0, not -1."]),
        (["train", "mine", "--checkpoint-seconds", "nan"], ["at least 0, not nan."]),
        (["train", "mine", "--log-every", "0"], ["--log-every is a number of steps, at least 1, not 0."]),
        (["train", "mine", "--config", "nope.json"], ["there is no file nope.json: check the path."]),
        (["train", "mine", "--set", "steps=2"], ["are flags: write --steps 2 in place of --set steps=2."]),
        (["train", "mine", "--set", "joint.horizons=8,16"], ["write --joint.horizons 8 16 in"]),
        (["train", "mine", "--set", "coupled_masses=false"], ["write --no-coupled-masses in"]),
        (
            ["train", "mine", "--model", "hgn", "--mechanism", "pendulum"],
            ["the model hgn takes no constraints: leave out --mechanism"],
        ),
        (["train", "mine", "--coordinator", "foo", "--processes", "2"], ["--coordinator is ADDRESS:PORT", "'foo'"]),
        (["train", "mine", "--coordinator", "foo:1", "--processes", "2"], ["--coordinator foo:1 needs --processes"]),
        (["demo", "zoo/four_bar"], ["'zoo/four_bar' of the demo: choose from acrobot, cartpole, pendulum."]),
        (["train", "mine", "--seed", "-1"], ["from 0 to", "not -1"]),
        (["train", "--config", "whole/config.json", "--seed", "3", "--out", "whole"], ["seed was 0, now 3"]),
        (["trian", "mine"], ["did you mean 'train'"]),
        (["eval", "nowhere"], ["nowhere", "run folder"]),
        (["predict", "pendulm", "--data", "mine/test.h5", "--out", "p.h5"], ["did you mean 'pendulum'"]),
        (["predict", "whole", "--data", "none.h5", "--out", "p.h5"], ["none.h5"]),
        (["predict", "whole", "--data", "mine/test.h5", "--out", "p.h5", "--given", "0"], ["--given is at least 2"]),
        (["eval", "whole", "--given", "0"], ["--given is at least 2, the frames that this model needs, not 0."]),
        (["data", "make", "cartpol"], ["did you mean 'cartpole'"]),
        (["data", "check", "nothing"], ["nothing"]),
    ],
)
def test_mistakes_get_one_sentence_and_code_two(here, place, arguments, words):
    (place / "file").write_text("")
    code, message = here(*arguments, folder=place)
    assert code == 2, message
    last = message.strip().splitlines()[-1]
    assert last.startswith("keycld: ") and all(word in last for word in words), message


def test_help_lists_the_options_of_the_command_itself(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    said = capsys.readouterr().out
    assert all(f"\n  {option} " in said for option in ("--debug", "--no-compile-cache", "-V, --version"))


def test_an_unknown_option_is_code_two_too(here, place):
    with pytest.raises(SystemExit) as end:
        here("train", "mine", "--sede", "3", folder=place)
    assert end.value.code == 2


def test_a_real_process_prints_the_sentence_and_no_traceback(place):
    answer = keycld("train", "pendulm", folder=place)
    assert answer.returncode == 2 and answer.stdout == ""
    assert answer.stderr.startswith("keycld: ") and len(answer.stderr.strip().splitlines()) == 1


def test_models_are_listed_for_people_and_programs(place, capsys):
    answer = keycld("models", "--json", folder=place)
    assert answer.returncode == 0, answer.stderr
    rows = {row["name"]: row for row in json.loads(answer.stdout)}
    assert {"fast", "paper", "journal"} <= set(rows["keycld"]["presets"])
    assert "energies" in rows["keycld"]["capabilities"] and "energies" not in rows["node2"]["capabilities"]
    assert all(row["parameters"] > 10_000 for row in rows.values())
    assert main(["models"]) == 0 and "node2" in capsys.readouterr().out


def test_check_finds_no_problem_in_good_data(place):
    answer = keycld("data", "check", "mine", folder=place)
    assert answer.returncode == 0 and "mine: no problems" in answer.stdout


def test_info_names_packages_and_renderer(place):
    answer = keycld("info", folder=place)
    assert answer.returncode == 0, answer.stderr
    assert "jax" in answer.stdout and "renderer" in answer.stdout


def test_no_gl_is_one_sentence(place):
    """MuJoCo with a GL that is missing: one sentence says what is missing and what to install."""
    command = [sys.executable, "-m", "keycld.cli.main", "data", "make", "pendulum", "--train", "1", "--out", "gl"]
    broken = os.environ | {"MUJOCO_GL": "egl", "__EGL_VENDOR_LIBRARY_FILENAMES": "/nowhere.json"}
    answer = subprocess.run(command, cwd=place, env=broken, capture_output=True, text=True, check=False)
    assert answer.returncode == 2, answer.stderr
    assert "Traceback" not in answer.stderr and "libegl1" in answer.stderr


def test_foreign_data_trains_with_constraints_given_on_the_command_line(here, place):
    """No constraints.toml next to the data: --constraints FILE is enough, also to predict later."""
    folder = write_data(place / "bare")
    (folder / "constraints.toml").rename(place / "mine.toml")
    code, message = here("train", "bare", "--out", "bare-run", folder=place)
    assert code == 2 and "put a constraints.toml next to the data" in message
    vision_alone = ["--dynamics.steps", "0", "--joint.steps", "0", "--log-every", "2"]
    settings = ["--constraints", "mine.toml", "--out", "bare-run", *SETTINGS, *vision_alone]
    code, message = here("train", "bare", *settings, folder=place)
    assert code == 0, message
    code, message = here("predict", "bare-run", "--data", "bare/test.h5", "--out", "bare.h5", folder=place)
    assert code == 0, message
