"""`keycld watch` through the real command line, on tiny synthetic clips."""

import contextlib
import json
import socket
import subprocess
import threading
import time
import urllib.error
import urllib.request

import h5py
import numpy as np
import pytest

from keycld import KeycldError
from keycld.cli.main import main
from keycld.cli.watch import measured_by_hand, scale_of
from keycld.drawing import load_image, save_movie
from keycld.mechanics import Candidate, load_constraints
from keycld.models.keycld import discover as discovery

_TINY = [
    "width=8", "substeps=1", "vision.steps=150", "vision.candidates=1", "vision.batch=8", "vision.worst=1e9",
    "dynamics.worst=1e9", "terms=viscous,",
]  # fmt: skip


def swing(frames=66, *, size=(40, 48)):
    """A bright disc that swings around (24, 4) in a grey picture."""
    row, column = np.mgrid[: size[0], : size[1]]
    angle = 0.9 * np.exp(-0.004 * np.arange(frames)) * np.cos(2 * np.pi * np.arange(frames) / 30)
    x, y = 24 + 24 * np.sin(angle), 4 + 24 * np.cos(angle)
    far = np.hypot(column[None] - x[:, None, None], row[None] - y[:, None, None])
    disc = np.clip(4.5 - far, 0, 1)[..., None]
    return np.round(40 + disc * np.array([200.0, 120.0, 30.0])).astype(np.uint8)


def tiny():
    """A dot of three pixels that runs around the whole picture."""
    frames = np.full((66, 40, 48, 3), 200, np.uint8)
    for t, angle in enumerate(2 * np.pi * np.arange(66) / 40):
        row, column = round(20 - 18 * np.cos(angle)), round(24 + 18 * np.sin(angle))
        frames[t, row - 1 : row + 2, column - 1 : column + 2] = 0
    return frames


def video(path, frames):
    save_movie(path, frames, fps=25.0, scale=1)
    return path


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A clip and a run that has watched it."""
    folder = tmp_path_factory.mktemp("watch")
    video(folder / "swing.mp4", swing())
    assert main(words(folder)) == 0
    return folder


def words(folder, *more, clip="swing.mp4"):
    return ["watch", str(folder / clip), "--mechanism", "pendulum", "--size", "16", "--out", str(folder / "run"),
            "--set", *_TINY, *more]  # fmt: skip


def test_a_clip_becomes_a_page_and_constants(place):
    run = place / "run"
    physics = json.loads((run / "evaluation" / "physics.json").read_text())
    assert physics["mechanism"] == "pendulum" and physics["fps"] == pytest.approx(25)
    assert {"pivot_x", "pivot_y", "length_pivot_ball", "viscous_rate"} <= physics["constants"].keys()
    assert {"error", "valid", "baselines"} <= physics["prediction"].keys()
    page = (run / "report.html").read_text()
    assert "<video" in page and "Constants" in page and "pivot_x" in page and 'src="http' not in page


def test_the_same_command_resumes_and_other_clips_need_another_run(place, capsys):
    before = (place / "run" / "data" / "train.h5").stat().st_mtime_ns
    dead = subprocess.Popen(["true"])
    dead.wait()
    left = place / "run" / "data" / f".statistics.json.{dead.pid}@{socket.gethostname()}.partial"
    left.mkdir()
    assert main(words(place, "--json")) == 0
    assert not left.exists()
    told = capsys.readouterr()
    assert json.loads(told.out)["constants"].keys() and "clip     " not in told.err and "vision   " not in told.err
    assert (place / "run" / "data" / "train.h5").stat().st_mtime_ns == before
    assert main(words(place, "--fps", "100")) == 2
    assert "is of other fps: choose another --out" in capsys.readouterr().err


@pytest.mark.slow
def test_a_video_played_as_a_camera_is_shown_with_its_next_second(place, capsys):
    """At the video's speed: 66 frames of 25 a second, of which a browser that is there from the start sees most."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    found = []

    def browse():
        for _ in range(600):
            with contextlib.suppress(urllib.error.URLError):
                page = urllib.request.urlopen(f"http://127.0.0.1:{port}/").read()
                found.extend([page, urllib.request.urlopen(f"http://127.0.0.1:{port}/pictures").read()])
                return
            time.sleep(0.1)

    browser = threading.Thread(target=browse)
    browser.start()
    live = ["watch", str(place / "swing.mp4"), "--live", str(place / "run"), "--port", str(port)]
    assert main([*live, "--ahead", "0.4"]) == 0
    browser.join()
    page, stream = found
    assert b'<img src="pictures"' in page and b"//" not in page
    pictures = [part.split(b"\r\n\r\n", 1)[1][:-2] for part in stream.split(b"--next\r\n")[1:]]
    assert len(pictures) >= 5
    first, last = load_image(pictures[0]), load_image(pictures[-1])
    assert first.shape == last.shape == (512, 512, 3)
    # The keypoint's ring and, later, the dots ahead of it have a colour that the grey picture lacks.
    pink = [np.sum((picture[..., 0] > 200) & (picture[..., 1] < 90)) for picture in (first, last)]
    assert pink[1] > pink[0] > 0
    told = capsys.readouterr().out.splitlines()[-1]
    assert told.startswith("66 frames, ") and "predictions 0.4 s ahead were off by" in told

    for change, sentence in (
        (["--port", "70000"], "port 70000 cannot be used"),
        (["--ahead", "0"], "--ahead is a time of 1 to 1000 frames of 0.04 s, not 0.0 s"),
        (["--ahead", "nan"], "--ahead is a time of 1 to 1000 frames of 0.04 s, not nan s"),
        (["--given", "1"], "--given is a number of frames from 2 to 1000, not 1"),
    ):
        assert main([*live, *change]) == 2
        assert sentence in capsys.readouterr().err
    assert main(["watch", "/dev/null", *live[2:]]) == 2
    assert "/dev/null is no camera that gives pictures of the size" in capsys.readouterr().err
    assert main(["watch", "a.mp4", "b.mp4", *live[2:]]) == 2
    assert "--live shows one video or camera, not 2" in capsys.readouterr().err
    assert main(["watch", "a.mp4"]) == 2
    assert "name what moves, such as --mechanism pendulum" in capsys.readouterr().err


def test_prediction_of_a_video_from_any_moment(place, capsys):
    out = place / "later.h5"
    arguments = ["predict", str(place / "run"), "--data", str(place / "swing.mp4"), "--out", str(out)]
    assert main([*arguments, "--from", "1.2s", "--given", "10"]) == 0
    with h5py.File(out) as file:
        assert file["keypoints"].shape == (1, 66, 1, 2) and file.attrs["first_given_frame"] == 30
        assert file["image"].shape == (1, 66, 16, 16, 3)
    capsys.readouterr()
    for wrong, sentence in (
        (["--from", "soon"], "--from is the number of a frame, or a time such as 12.5s, not 'soon'"),
        (["--from", "1e300s"], "--from is the number of a frame, or a time such as 12.5s, not '1e300s'"),
        (["--from", "3s", "--given", "10"], "is frame 75, but in"),
    ):
        assert main([*arguments, *wrong]) == 2
        assert sentence in capsys.readouterr().err
    other = video(place / "wide.mp4", swing(size=(40, 64)))
    assert main([*arguments[:3], str(other), *arguments[4:]]) == 2
    assert "has 64 x 40 pixels, the video that was learned 48 x 40" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("frames", "sentence"),
    [
        (lambda: swing(2), "has 2 frames, but 60 are the least"),
        (lambda: np.repeat(swing(1), 80, axis=0), "nothing moves in"),
        (lambda: np.stack([np.roll(_texture(), 2 * k, axis=1) for k in range(70)]), "the whole picture moves in"),
        (
            lambda: np.concatenate([swing(40), 255 - swing(40)]),
            "has a cut at 1.60 s: name the part",
        ),
        (lambda: np.zeros((2, 2160, 3840, 3), np.uint8), "has 2 frames, but 60 are the least"),
        (None, "cannot be read as a video"),
        (lambda: tiny(), "too few to be followed: add --size 40"),
    ],
    ids=["two-frames", "still", "moving-camera", "cut", "4K", "corrupt", "tiny"],
)
def test_wrong_videos_get_one_sentence_and_leave_nothing(tmp_path, capsys, frames, sentence):
    path = tmp_path / "swing.mp4"
    if frames is None:
        whole = video(path, swing()).read_bytes()
        path.write_bytes(whole[: len(whole) // 3])
    else:
        video(path, frames())
    assert main(words(tmp_path)) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert told[-1].startswith("keycld: ") and sentence in told[-1]
    assert [each.name for each in tmp_path.iterdir()] == ["swing.mp4"]


def test_the_data_of_another_process_stay(tmp_path, monkeypatch, capsys):
    """It began at the same time and was faster: this one found no folder, and is refused at the end of its import."""
    import keycld.data

    def refused(clips, folder, **options):
        folder.mkdir(parents=True)
        (folder / "train.h5").touch()
        raise KeycldError(f"{folder} already holds data")

    monkeypatch.setattr(keycld.data, "import_clip", refused, raising=False)
    video(tmp_path / "swing.mp4", swing(2))
    assert main(words(tmp_path)) == 2
    assert "already holds data" in capsys.readouterr().err
    assert (tmp_path / "run" / "data" / "train.h5").exists()


def test_a_comparison_whose_clip_is_refused_later_stays_for_no_other_clip(tmp_path, capsys, monkeypatch):
    held = {"distance_to_point ball": 0.0}
    circle = Candidate("pendulum", load_constraints("pendulum"), np.zeros((60, 2)), np.ones(60, bool), held)
    monkeypatch.setattr(discovery, "discover", lambda frames, fitted, dt: [discovery.Judged(circle, 0.01, True)])
    video(tmp_path / "swing.mp4", swing())
    command = ["watch", str(tmp_path / "swing.mp4"), "--mechanism", "auto", "--out", str(tmp_path / "run")]
    for wrong, sentence in (
        (["--size", "20"], "multiple of 8"),
        (["--size", "0"], "multiple of 8, not 0"),
        (["--length", "a-b = 1 m"], "no length a-b"),
    ):
        assert main([*command, *wrong]) == 2
        assert sentence in capsys.readouterr().err
        assert [each.name for each in tmp_path.iterdir()] == ["swing.mp4"]


def test_a_clip_in_which_no_mechanism_is_found_says_so(tmp_path, capsys, monkeypatch):
    """Its candidates are stored, so that the same command answers at once."""
    held = {"distance_to_point ball": 0.2}
    circle = Candidate("pendulum", load_constraints("pendulum"), np.zeros((60, 2)), np.ones(60, bool), held)
    monkeypatch.setattr(discovery, "discover", lambda frames, fitted, dt: [discovery.Judged(circle, None)])
    video(tmp_path / "swing.mp4", swing())
    command = ["watch", str(tmp_path / "swing.mp4"), "--mechanism", "auto", "--out", str(tmp_path / "run"), "--json"]
    for _ in range(2):
        assert main(command) == 0
        physics = json.loads(capsys.readouterr().out)
        monkeypatch.setattr(discovery, "discover", None)
    assert physics["mechanism"] is None and physics["constants"] == {} and "not identifiable" in physics["note"]
    assert physics["alternatives"] == [
        {
            "mechanism": "pendulum",
            "keypoints": ["ball"],
            "constraints": {"distance_to_point ball": 0.2},
            "freedom": 1,
            "prediction": None,
            "chosen": False,
        }
    ]


def _texture():
    random = np.random.default_rng(0)
    return np.repeat(np.repeat(random.integers(0, 255, (10, 12, 3), np.uint8), 4, axis=0), 4, axis=1)


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["--length", "31 cm"], 'such as "pivot-ball = 0.31 m"'),
        (
            ["--length", "pivot-tip = 31 cm"],
            "no length pivot-tip is constant in this mechanism: choose from pivot",
        ),
        (["--gravity", "-9.8"], "above 0"),
        (["--seed", "-1"], "a seed is a number from 0 to 4294967295, not -1"),
        (["--size", "20"], "--size is a positive multiple of 8, not 20"),
        (["--crop", "0", "0", "50", "50"], "--crop 0 0 50 50 does not lie inside"),
    ],
)
def test_wrong_options(tmp_path, capsys, more, sentence):
    video(tmp_path / "swing.mp4", swing())
    assert main([*words(tmp_path), *more]) == 2
    assert sentence in capsys.readouterr().err.strip().splitlines()[-1]
    assert [each.name for each in tmp_path.iterdir()] == ["swing.mp4"]


def test_units_of_a_length(tmp_path):
    assert scale_of("ball – pivot = 31cm", None, "pendulum") == (("pivot", "ball"), pytest.approx(0.31))
    assert scale_of(None, 9.81, "pendulum") == (None, 9.81) and scale_of(None, None, "pendulum") is None
    toml = tmp_path / "two.toml"
    toml.write_text(
        'keypoints = ["left-ball", "right-ball"]\n\n[[constraint]]\nkind = "fixed_distance"\n'
        'between = ["left-ball", "right-ball"]\n'
    )
    between = ("left-ball", "right-ball")
    assert scale_of("right-ball - left-ball = 2 m", None, str(toml)) == (between, 2.0)
    scale = scale_of("pivot-ball = 310 mm", 9.81, "pendulum")
    assert measured_by_hand(scale, 9.81) == {"length_pivot_ball_m": pytest.approx(0.31), "gravity_m": 9.81}


@pytest.mark.slow
def test_a_clip_that_no_network_learns_is_measured_on_the_middles_of_its_parts(tmp_path, capsys, monkeypatch):
    """A disc on a circle of 24 pixels, hanging: by a network that eight steps teach nothing."""
    video(tmp_path / "swing.mp4", swing(150))
    tiny = [*_TINY[:2], "vision.steps=8", *_TINY[3:5], "vision.worst=1e-9"]
    command = ["watch", str(tmp_path / "swing.mp4"), "--mechanism", "pendulum", "--size", "16", "--json",
               "--length", "pivot-ball = 0.24 m", "--out", str(tmp_path / "run"), "--set", *tiny]  # fmt: skip
    assert main(command) == 0
    told = capsys.readouterr()
    physics = json.loads(told.out)
    assert "caution      training failed 3 times" in told.err and "no network has learned this clip" in told.err
    assert physics["note"].startswith("no network") and physics["mechanism"] == "pendulum"
    found = {name: each["value"] for name, each in physics["constants"].items()}
    assert found["viscous_rate"] == pytest.approx(0.2, abs=0.05)  # 2 ⋅ 0.004 a frame, 25 frames a second
    assert found["length_pivot_ball_m"] == pytest.approx(0.24)
    assert physics["given"] == {"length_pivot_ball_m": 0.24}
    page = (tmp_path / "run" / "report.html").read_text()
    assert "<h1>Run</h1>" in page and "Failed" in page and "Caution: no network" in page and "pivot_x" in page

    def lost(frames, fitted, dt):
        raise KeycldError("the parts cannot be followed")

    for found in (lambda frames, fitted, dt: []), lost:
        monkeypatch.setattr(discovery, "discover", found)
        assert main(command) == 2
        told = capsys.readouterr()
        assert not told.out and told.err.splitlines()[-1].startswith("keycld: training failed 3 times")
