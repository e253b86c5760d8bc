"""What people really pass to the command: files of theirs in the way, other encodings, mistyped options."""

import dataclasses
import json
import re
import subprocess

import imageio_ffmpeg
import numpy as np
import pytest

from keycld import data as data_room
from keycld._errors import KeycldError
from keycld.cli.alternatives import compare
from keycld.cli.main import main
from keycld.cli.train import train
from keycld.data import open_data, write
from keycld.data.export.tracks import KeypointTracks, write_time_series
from keycld.data.generate import make
from keycld.data.imports.log import read_log
from keycld.drawing import save_movie
from keycld.models import Scene, config_for
from keycld.training import data_folder
from keycld.training.run_files import RunConfig
from scenes import disc_pendulum, write_data

LOG = ["time,angle,tau", *(f"{k / 100},{np.sin(k / 9):.5f},{np.cos(k / 7):.5f}" for k in range(60))]
IDENTIFY = ["--mechanism", "pendulum", "--position", "angle", "--input", "tau"]


@pytest.fixture
def clip(tmp_path):
    frames = np.full((40, 32, 32, 3), 40, np.uint8)
    for t in range(40):
        frames[t, 10:16, t % 26 : t % 26 + 6] = 220
    save_movie(tmp_path / "a clip.mp4", frames, fps=25.0, scale=1)
    return tmp_path / "a clip.mp4"


def refused(capsys, *words):
    assert main([str(word) for word in words]) == 2
    return capsys.readouterr().err


def test_predictions_do_not_replace_the_video(clip, capsys):
    before = clip.read_bytes()
    assert "is the data itself" in refused(capsys, "predict", "pendulum", "--data", clip, "--out", clip)
    assert clip.read_bytes() == before


def test_a_video_in_place_of_data_is_answered_by_how_to_make_some(clip, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for words in (["train", clip], ["predict", "pendulum", "--data", clip, "--out", "p.h5"]):
        assert f"`keycld data import {clip} --out FOLDER`" in refused(capsys, *words)


@pytest.mark.parametrize("words", [["none.h5", "--from", "1.5s"], ["none.mp4"], ["none"]])
def test_a_missing_file_to_predict_is_no_wrong_time_and_no_video(tmp_path, monkeypatch, capsys, words):
    monkeypatch.chdir(tmp_path)
    answer = refused(capsys, "predict", "pendulum", "--out", "p.h5", "--data", *words)
    assert f"there is no file {words[0]}: check the path" in answer


def test_a_long_test_is_made_before_a_time_in_it_is_looked_up(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(make, "provide", lambda path: write(path, disc_pendulum(1, 40, seed=0)))
    words = ["predict", "pendulum", "--out", tmp_path / "p.h5", "--data", tmp_path / "test_long.h5"]
    assert "frames of 64 × 64 pixels" in refused(capsys, *words, "--from", "1.5s")


def test_a_video_with_fewer_frames_than_are_given_is_called_short(clip, tmp_path, monkeypatch, capsys):
    """Not a wrong --from, which nobody gave."""
    monkeypatch.chdir(tmp_path)
    write_data(tmp_path / "data" / "pendulum")
    monkeypatch.setattr(data_room, "clip_file", lambda video, out, *given, **named: write_short(out))
    answer = refused(capsys, "predict", "pendulum", "--data", clip, "--out", "p.h5", "--given", "10")
    assert f"{clip} gives 4 frames, but 10 are to be given to the model" in answer


def write_short(path):
    write(path, disc_pendulum(1, 4, seed=0))
    return path


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["watch", "a.mp4", "--mechnism", "pendulum"], "--mechanism"),
        (["models", "--jsn"], "--json"),
        (["data", "import", "a.mp4", "--siz", "16", "--out", "d"], "--size"),
    ],
)
def test_a_mistyped_option_is_named_with_the_nearest_one(words, meant, capfd):
    with pytest.raises(SystemExit) as end:
        main(words)
    printed = "".join(capfd.readouterr())
    wrong = next(word for word in words if word.startswith("--"))
    assert end.value.code == 2 and f"Unrecognized options: {wrong}" in printed and meant in printed


@pytest.mark.parametrize(("here", "data"), [("mine", "."), ("mine/below", "..")])
def test_what_is_made_of_the_data_here_has_their_name(tmp_path, monkeypatch, capsys, here, data):
    write_data(tmp_path / "mine")
    (tmp_path / here).mkdir(exist_ok=True)
    monkeypatch.chdir(tmp_path / here)
    assert main(["data", "show", data]) == 0
    assert capsys.readouterr().out == "movie: mine-train-0.gif\n"
    with pytest.raises(InterruptedError, match="^runs/mine-keycld-fast-0$"):
        monkeypatch.setattr("keycld.training.train", stopped)
        train(data, settings=config_for("keycld", "fast"))


def stopped(data, run, *given, **named):
    raise InterruptedError(run)


@pytest.mark.parametrize("name", ["README.md", "preview.gif", "constraints.toml"])
def test_an_import_replaces_no_file_of_others(clip, tmp_path, name, capsys):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / name).write_text("my notes")
    words = ["data", "import", clip, "--out", tmp_path / "mine", "--frames", "10", "--size", "16"]
    assert f"holds a {name} that data would replace" in refused(capsys, *words, "--mechanism", "pendulum")
    assert {path.name for path in (tmp_path / "mine").iterdir()} == {name}
    assert (tmp_path / "mine" / name).read_text() == "my notes"


def test_making_data_replaces_no_readme_of_others(tmp_path, capsys):
    (tmp_path / "README.md").write_text("my notes")
    words = ["data", "make", "toy/mass_spring", "--train", "2", "--test", "1", "--out", tmp_path]
    assert "holds a README.md that data would replace" in refused(capsys, *words)
    assert (tmp_path / "README.md").read_text() == "my notes"


def test_an_import_of_a_published_set_refuses_the_options_of_videos(tmp_path, capsys):
    (tmp_path / "pendulum").mkdir()
    (tmp_path / "pendulum" / "features.txt").touch()
    words = ["data", "import", tmp_path / "pendulum", "--out", tmp_path / "out"]
    told = refused(capsys, *words, "--size", "32", "--mechanism", "pendulum", "--from", "0", "--split", "time")
    assert "is imported as it was published: leave out --size, --split, --constraints, --from." in told
    assert "imported as it was" not in refused(capsys, *words)


def test_a_raw_stream_and_a_folder_named_like_the_mechanism(clip, tmp_path, monkeypatch):
    """Such as a Raspberry Pi's camera writes: without times to skip to."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pendulum").mkdir()
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", clip, "-c", "copy", "pendulum/raw.h264"]
    subprocess.run(command, check=True)
    words = ["data", "import", "pendulum/raw.h264", "--out", "d", "--frames", "10", "--size", "16"]
    assert main([*words, "--mechanism", "pendulum"]) == 0
    assert sum(len(open_data("d").split(name)) for name in ("train", "validation", "test")) == 4


def test_the_data_of_a_run_that_was_moved_are_in_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert str(data_folder(tmp_path / "new", "runs/old/data")) == "runs/old/data"
    (tmp_path / "new" / "data").mkdir(parents=True)
    assert data_folder(tmp_path / "new", "runs/old/data") == tmp_path / "new" / "data"
    (tmp_path / "runs" / "old" / "data").mkdir(parents=True)
    assert str(data_folder(tmp_path / "new", "runs/old/data")) == "runs/old/data"


@pytest.mark.parametrize(
    ("lines", "more", "sentence"),
    [
        (["time;angle;tau", *LOG[1:]], [], "columns of .* are separated by ';': separate them by commas"),
        (["x" * 200_000, *LOG], [], "cannot be read as CSV .field larger than field limit"),
        (LOG, ["--lengths", "1", "2"], "--lengths are 1 lengths above 0, one a joint, not 1 2"),
        (LOG, ["--lengths", "0"], "--lengths are 1 lengths above 0, one a joint, not 0"),
        ([line if k == 0 else line.rpartition(",")[0] + ",0" for k, line in enumerate(LOG)], [], "torques .* are zero"),
    ],
)
def test_logs_and_lengths_that_tell_nothing_are_refused(tmp_path, lines, more, sentence, capsys):
    (tmp_path / "log.csv").write_text("\n".join(lines))
    assert re.search(sentence, refused(capsys, "identify", tmp_path / "log.csv", *IDENTIFY, *more))


def test_a_table_as_excel_writes_it_is_read(tmp_path):
    (tmp_path / "log.csv").write_text("﻿" + "\r\n".join([*LOG, "", ""]), encoding="utf-8")
    assert read_log(tmp_path / "log.csv", ("angle",), ("tau",)).q.shape == (60, 1)


def test_an_export_leaves_no_recording_of_an_earlier_one(tmp_path):
    (tmp_path / "recording_of_my_rig.npz").touch()
    for count in (3, 1):
        tracks = KeypointTracks(("bob",), np.zeros((count, 5, 1, 2)), np.zeros((count, 5, 0)), 0.1, ())
        paths = write_time_series(tmp_path, tracks)
    assert sorted(tmp_path.glob("*.npz")) == [*paths, tmp_path / "recording_of_my_rig.npz"] and len(paths) == 1


def test_watch_does_not_write_into_a_run_of_train(clip, tmp_path, capsys):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.json").write_text("{}")
    words = ["watch", clip, "--mechanism", "pendulum", "--out", tmp_path / "run"]
    assert "is a run of keycld train: choose another --out" in refused(capsys, *words)
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["config.json"]


def test_sizes_in_a_damaged_configuration_are_named(tmp_path, capsys):
    scene = dataclasses.asdict(Scene(-64, 64, 0, 10, 0.1, 4))
    settings = config_for("keycld", "fast").settings()
    config = RunConfig("data", None, "mine", "keycld", "fast", settings, 0, scene, (), 0.1, 1, 60.0, "train")
    (tmp_path / "config.json").write_text(json.dumps(dataclasses.asdict(config)))
    told = refused(capsys, "export", tmp_path, "--to", "csv")
    assert "('scene.height' is -64, but must be at least 1): restore it or train again." in told


@pytest.mark.parametrize("contents", ["{}", '{"alternatives": [{"chosen": true}]}'])
def test_a_damaged_comparison_of_mechanisms_is_named(tmp_path, contents):
    (tmp_path / "alternatives.json").write_text(contents)
    with pytest.raises(KeycldError, match="alternatives.json is damaged .* is missing.*: delete"):
        compare(tmp_path / "a.mp4", tmp_path, {})
