"""A video becomes a data set."""

import shutil

import numpy as np
import pytest

from keycld import KeycldError
from keycld.data import check, import_clip, import_video, open_data, read
from keycld.data.imports import video as importing
from keycld.drawing import save_movie


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """120 frames, 25 a second, of a bright disc that swings over a dark ground, 96 × 64 pixels."""
    row, column = np.mgrid[:64, :96]
    frames = []
    for k in range(120):
        centre = 48 + 20 * np.sin(2 * np.pi * k / 40)
        disc = (column - centre) ** 2 + (row - 32) ** 2 < 36
        frames.append(np.where(disc[..., None], (220, 180, 40), (20, 30, 60)).astype(np.uint8))
    path = tmp_path_factory.mktemp("video") / "swing.mp4"
    save_movie(path, np.stack(frames), fps=25.0, scale=1)
    return path


def _centre(image):
    disc = np.maximum(image[..., 0].astype(float) - 60.0, 0.0)
    return np.sum(disc * np.arange(disc.shape[1])) / np.sum(disc)


def test_a_video_becomes_three_splits(video, tmp_path):
    out = import_video(video, tmp_path / "swing", size=32, frames=20)
    assert check(out) == []
    data = open_data(out)
    assert (data.system, data.dt) == ("swing", 0.04)
    train = data.train()
    assert train.image.shape == (4, 20, 32, 32, 3)
    assert (len(data.validation()), len(data.test())) == (1, 1)
    assert train.state is None and train.input.shape == (4, 0)
    assert train.attributes["input_names"] == () and data.input_names == ()
    for k in (0, 7, 13):
        # The middle square of 64 pixels starts at column 16; two video pixels make one.
        wanted = (48 + 20 * np.sin(2 * np.pi * k / 40) - 16) / 2 - 0.25
        assert _centre(train.image[0, k]) == pytest.approx(wanted, abs=0.6)
    assert (out / "README.md").exists() and (out / "preview.gif").exists()


def test_time_runs_on_through_the_splits(video, tmp_path):
    """Recordings follow one another; with frame 80 on as the test, the disc is where it was at frame 0."""
    out = import_video(video, tmp_path / "a", size=32, frames=40)
    train, test = read(out / "train.h5"), read(out / "test.h5")
    assert _centre(test.image[0, 5]) == pytest.approx(_centre(train.image[0, 5]), abs=0.3)


def test_crop_rate_and_skip(video, tmp_path):
    out = import_video(video, tmp_path / "a", size=16, frames=10, fps=12.5, crop=(32, 16, 32, 32), skip=0.8)
    train = read(out / "train.h5")
    assert train.dt == pytest.approx(0.08) and train.image.shape[1:] == (10, 16, 16, 3)
    wanted = (48 + 20 * np.sin(2 * np.pi * 20 / 40) - 32) / 2
    assert _centre(train.image[0, 0]) == pytest.approx(wanted, abs=1.5)


def test_a_crop_may_begin_at_an_odd_pixel(video, tmp_path):
    """The colours of the video have half the resolution."""
    even, odd = (
        read(import_video(video, tmp_path / str(left), size=32, frames=10, crop=(left, 16, 32, 32)) / "train.h5")
        for left in (32, 33)
    )
    assert _centre(even.image[0, 0]) - _centre(odd.image[0, 0]) == pytest.approx(1.0, abs=0.3)


def test_several_videos(video, tmp_path):
    shutil.copy(video, tmp_path / "more.mp4")
    out = import_video([video, tmp_path / "more.mp4"], tmp_path / "a", size=16, frames=30)
    assert sum(len(read(out / f"{name}.h5")) for name in ("train", "validation", "test")) == 8


def test_the_names_of_many_videos_fit_into_the_file(video, tmp_path):
    """Phones give names of thirty letters, and the format's texts have a thousand at most."""
    several = [tmp_path / f"{'VID_20260101_120000' * 12}_{k}.mp4" for k in range(5)]
    for path in several:
        shutil.copy(video, path)
    out = import_video(several, tmp_path / "a", size=16, frames=60)
    made = open_data(out).attributes["generator"]
    assert check(out) == [] and "import of 5 videos, VID_20260101" in made and len(made) < 1000


def test_videos_of_different_sizes_are_not_of_one_camera(video, tmp_path):
    save_movie(tmp_path / "wide.mp4", np.zeros((40, 64, 128, 3), np.uint8), fps=25.0, scale=1)
    with pytest.raises(KeycldError, match="wide.mp4 has 128 x 64 pixels, .* 96 x 64: give videos from the same camera"):
        import_video([video, tmp_path / "wide.mp4"], tmp_path / "a", size=16, frames=20)


def test_constraints_come_along(video, tmp_path):
    toml = tmp_path / "mine.toml"
    toml.write_text('keypoints = ["bob"]\n\n[[constraint]]\nkind = "distance_to_point"\nkeypoint = "bob"\n')
    out = import_video(video, tmp_path / "a", size=16, frames=20, constraints=toml)
    assert open_data(out).keypoints == ("bob",)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frames": 50}, "the videos give 2 recordings of 50 frames"),
        ({"frames": 2}, "--frames is at least 3, not 2"),
        ({"fps": 50.0}, "at most the 25 of"),
        ({"fps": 0.0}, "--fps is above 0"),
        ({"crop": (0, 0, 40, 30)}, "--crop is a square, not 40 x 30"),
        ({"crop": (80, 0, 32, 32)}, "does not lie inside the 96 x 64 pixels"),
        ({"size": 60}, "multiple of 8"),
        ({"skip": -1.0}, "--from is a second of the video, at least 0, not -1"),
        ({"skip": 2.0, "until": 1.5}, r"--until is a second of the video after --from \(2\), not 1.5"),
        ({"skip": 60.0}, "no frame after 60 s"),
        ({"fps": 0.001}, "no frame after 0 s at 0.001 frames/s: skip less, or give a higher --fps"),
        ({"validation": 0.6, "test": 0.5}, "leave some for training"),
    ],
)
def test_bad_arguments(video, tmp_path, changes, words):
    with pytest.raises(KeycldError, match=words):
        import_video(video, tmp_path / "a", **{"frames": 20, **changes})
    assert not (tmp_path / "a").exists()


def test_a_killed_import_is_unfinished_and_resumed(video, tmp_path, monkeypatch):
    def dies(folder, made):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(importing, "finish", dies)
        with pytest.raises(KeyboardInterrupt):
            import_video(video, tmp_path / "a", size=16, frames=20)
    with pytest.raises(KeycldError, match="unfinished"):
        open_data(tmp_path / "a")
    assert open_data(import_video(video, tmp_path / "a", size=16, frames=20)).train().image is not None


def test_bad_files(video, tmp_path):
    with pytest.raises(KeycldError, match="there is no video"):
        import_video(tmp_path / "missing.mp4", tmp_path / "a")
    (tmp_path / "text.mp4").write_text("not a video")
    with pytest.raises(KeycldError, match="cannot be read as a video"):
        import_video(tmp_path / "text.mp4", tmp_path / "a")
    with pytest.raises(KeycldError, match="'pendulum' is the name of a system"):
        import_video(video, tmp_path / "pendulum", size=16, frames=20)
    with pytest.raises(KeycldError, match="at least one video"):
        import_video([], tmp_path / "a")
    for empty_or_twice, words in (([], "at least one video"), ([video, str(video)], "is named twice")):
        with pytest.raises(KeycldError, match=words):
            import_clip(empty_or_twice, tmp_path / "a", constraints="pendulum", size=16)
    out = import_video(video, tmp_path / "b", size=16, frames=20)
    with pytest.raises(KeycldError, match="already holds data"):
        import_video(video, out, size=16, frames=20)
