"""One video of one motion becomes a data set."""

import numpy as np
import pytest

from keycld import KeycldError
from keycld.data import check, clip_file, import_clip, is_clip, open_data, read
from keycld.drawing import save_movie


def swing(frames=90, seed=0, *, size=(96, 128), shift=0.0):
    """A bright disc that swings in the right half of a noisy picture; `shift` moves everything, pixels a frame."""
    random = np.random.default_rng(seed)
    row, column = np.mgrid[: size[0], : size[1]]
    found = []
    for k in range(frames):
        angle = 0.9 * np.cos(2 * np.pi * k / 40)
        x, y = 84 + 30 * np.sin(angle) + shift * k, 20 + 30 * np.cos(angle)
        disc = (column - x) ** 2 + (row - y) ** 2 < 36
        ground = 60 + (100 if shift else 40) * np.sin((column + shift * k) / 5.0) * np.cos(row / 7.0)
        grey = np.where(disc, 220.0, ground) + random.normal(size=size)
        found.append(np.repeat(np.clip(grey, 0, 255)[..., None], 3, axis=2).astype(np.uint8))
    return np.stack(found)


def video(folder, frames, name="swing.mp4"):
    path = folder / name
    save_movie(path, frames, fps=25.0, scale=1)
    return path


def test_a_clip_is_cropped_to_what_moves_and_split_in_time(tmp_path):
    clip = import_clip(video(tmp_path, swing()), tmp_path / "a", constraints="pendulum", size=32, fps=100.0)
    left, top, width, height = clip.crop
    assert width == height < 96 and left > 30
    # The disc, of radius 6, is inside at the ends of its swing and at the bottom.
    assert left < 84 - 30 * np.sin(0.9) - 6 and left + width > 84 + 30 * np.sin(0.9) + 6 and top + height > 56
    assert clip.frames == (54, 6, 30) and clip.fps == 100.0
    data = open_data(tmp_path / "a")
    assert check(tmp_path / "a") == [] and data.dt == pytest.approx(0.01) and data.keypoints == ("ball",)
    assert data.train().image.shape == (1, 54, 32, 32, 3) and data.test().frames == 30
    assert tuple(data.attributes["crop"]) == clip.crop


def test_long_parts_become_recordings_of_equal_length(tmp_path):
    path = video(tmp_path, swing())
    import_clip(path, tmp_path / "a", constraints="pendulum", size=32, crop=(32, 0, 96, 96), longest=20)
    assert open_data(tmp_path / "a").train().image.shape == (3, 18, 32, 32, 3)


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (lambda: swing(40), "has 40 frames, but 60 are the least"),
        (lambda: np.repeat(swing(1), 80, axis=0), "nothing moves in"),
        (lambda: swing(80, shift=1.0), "the whole picture moves in"),
        (lambda: np.concatenate([swing(40), 255 - swing(50)]), "has a cut at 44 % of its length"),
    ],
    ids=["short", "still", "camera", "cut"],
)
def test_wrong_videos_are_refused_and_leave_nothing(tmp_path, frames, message):
    path = video(tmp_path, frames())
    with pytest.raises(KeycldError, match=message):
        import_clip(path, tmp_path / "a", constraints="pendulum")
    assert [each.name for each in tmp_path.iterdir()] == ["swing.mp4"]


def test_no_videos(tmp_path):
    (tmp_path / "text.mp4").write_text("no video")
    with pytest.raises(KeycldError, match="cannot be read as a video"):
        import_clip(tmp_path / "text.mp4", tmp_path / "a", constraints="pendulum")
    with pytest.raises(KeycldError, match="there is no video"):
        import_clip(tmp_path / "none.mp4", tmp_path / "a", constraints="pendulum")


def test_the_motion_of_a_chain_is_learned_in_halves(tmp_path):
    import_clip(video(tmp_path, swing()), tmp_path / "a", constraints="double-pendulum", size=24)
    data = open_data(tmp_path / "a")
    assert data.train().image.shape[:2] == (2, 27) and data.test().image.shape[:2] == (1, 30)


def test_several_clips_of_one_place_share_crop_and_are_split_each(tmp_path):
    first = video(tmp_path, swing(), "a.mp4")
    second = video(tmp_path, swing(75, seed=1), "b.mp4")
    clip = import_clip([first, second], tmp_path / "both", constraints="pendulum", size=24)
    assert clip.frames == (54 + 45, 6 + 5, 30 + 25)
    data = open_data(tmp_path / "both")
    assert data.train().image.shape == (2, 45, 24, 24, 3) and data.test().image.shape[:2] == (2, 25)
    other = video(tmp_path, swing(70, size=(96, 112)), "c.mp4")
    with pytest.raises(KeycldError, match="give videos from the same camera and place"):
        import_clip([first, other], tmp_path / "c", constraints="pendulum")


def test_a_video_from_the_same_place_becomes_one_recording_as_the_clip_was(tmp_path):
    path = video(tmp_path, swing())
    import_clip(path, tmp_path / "a", constraints="pendulum", size=24, fps=100.0)
    data = open_data(tmp_path / "a")
    again = read(clip_file(path, tmp_path / "again.h5", data.attributes, 24))
    assert again.dt == pytest.approx(0.01) and is_clip(data.attributes)
    np.testing.assert_array_equal(again.image[0, :54], data.train().image[0])
    wide = video(tmp_path, swing(70, size=(96, 112)), "c.mp4")
    with pytest.raises(KeycldError, match="has 112 x 96 pixels, the video that was learned 128 x 96"):
        clip_file(wide, tmp_path / "b.h5", data.attributes, 24)
    with pytest.raises(KeycldError, match="the model learned from other data"):
        clip_file(path, tmp_path / "b.h5", {"protocol": "import"}, 24)
