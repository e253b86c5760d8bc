"""One video of one motion becomes a data set."""

from fractions import Fraction

import numpy as np
import pytest

from keycld import KeycldError
from keycld.data import changes_of, check, clip_file, import_clip, is_clip, open_data, read, usual_for
from keycld.data.imports.clip import MOST, _every
from keycld.data.imports.exposure import made_alike, usual_of
from keycld.data.imports.overlays import overlays
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


def test_a_part_of_a_video_is_named_by_its_seconds(tmp_path):
    """A hand that covers the right half for a second, then the motion, then another picture."""
    hand = swing(25)
    hand[:, :, 64:] = 210
    path = video(tmp_path, np.concatenate([hand, swing(75), 255 - swing(30)]))
    with pytest.raises(KeycldError, match="has a cut at 4.00 s: name the part before it with --until, or .* --from"):
        import_clip(path, tmp_path / "a", constraints="pendulum", size=32)
    clip = import_clip(path, tmp_path / "a", constraints="pendulum", size=32, skip=1.0, until=4.0)
    alone = import_clip(video(tmp_path, swing(75), "b.mp4"), tmp_path / "b", constraints="pendulum", size=32)
    assert clip.frames == alone.frames == (45, 5, 25) and np.allclose(clip.crop, alone.crop, atol=3)
    with pytest.raises(KeycldError, match="has 50 frames in this part, but 60 are the least"):
        import_clip(path, tmp_path / "c", constraints="pendulum", size=32, skip=1.0, until=3.0)


def with_clock(frames):
    """The same frames with four signs in the upper left corner, the last of which is another in each frame."""
    random, shown = np.random.default_rng(1), frames.copy()
    signs = 250 * random.integers(0, 2, (10, 6, 4)).astype(np.uint8)
    for k, frame in enumerate(shown):
        for place, sign in enumerate((3, 7, k // 10 % 10, k % 10)):
            frame[6:12, 8 + 5 * place : 12 + 5 * place] = signs[sign][..., None]
    return shown


def test_a_clock_is_painted_over_and_not_in_the_crop(tmp_path):
    plain = import_clip(video(tmp_path, swing()), tmp_path / "a", constraints="pendulum", size=32)
    path = video(tmp_path, with_clock(swing()), "clock.mp4")
    clip = import_clip(path, tmp_path / "b", constraints="pendulum", size=32)
    assert plain.painted == () and len(clip.painted) == 1
    left, top, width, height = clip.painted[0]
    assert left <= 18 and left + width >= 27 and top <= 6 and top + height >= 12 and width < 30 and height < 20
    (said,) = changes_of(open_data(clip.folder).attributes)
    assert said.endswith(f"such as a clock, is painted over: {width} × {height} pixels at {left}, {top}")
    assert changes_of(open_data(plain.folder).attributes) == []
    np.testing.assert_allclose(clip.crop, plain.crop, atol=1)
    whole = import_clip(path, tmp_path / "c", constraints="pendulum", size=96, crop=(0, 0, 96, 96))
    image = open_data(whole.folder).train().image[0].astype(float)
    assert image[:, top : top + height, left : left + width].std(axis=0).mean() < 5  # the noise alone, not the signs
    # Other videos of the same camera are seen in the same way.
    again = read(clip_file(path, tmp_path / "d.h5", open_data(whole.folder).attributes, 96)).image[0].astype(float)
    assert again[:, top : top + height, left : left + width].std(axis=0).mean() < 5


def exposed(frames):
    """The same frames by a camera that adapts slowly, within a fifth."""
    exposure = 0.85 + 0.1 * np.sin(2 * np.pi * np.arange(len(frames)) / 70)
    return np.round(frames * exposure[:, None, None, None]).astype(np.uint8)


def test_an_exposure_that_varies_is_evened_out(tmp_path):
    options = {"constraints": "pendulum", "size": 32, "crop": (32, 0, 96, 96)}
    plain = import_clip(video(tmp_path, 20 + swing() // 2), tmp_path / "a", **options)
    path = video(tmp_path, exposed(20 + swing() // 2), "exposed.mp4")
    clip = import_clip(path, tmp_path / "b", **options)
    assert plain.exposure == 0 and clip.exposure == pytest.approx(0.083, abs=0.005)
    data = open_data(tmp_path / "b")
    assert changes_of(data.attributes) == [f"the exposure varies by {clip.exposure:.1%}; it is evened out"]
    images = [open_data(folder).train().image[0].astype(float) for folder in (tmp_path / "a", tmp_path / "b")]
    ratios = np.mean(images[1], axis=(1, 2, 3)) / np.mean(images[0], axis=(1, 2, 3))
    assert np.std(ratios) < 0.005 < 0.05 < np.std(exposed(np.full((54, 1, 1, 3), 100)).mean(axis=(1, 2, 3)) / 100)
    # Other videos of the same camera are seen in the same way.
    again = read(clip_file(path, tmp_path / "c.h5", data.attributes, 32, usual=usual_for(data))).image[0, :54]
    assert np.mean(np.abs(again - images[1])) < 1 and usual_for(open_data(tmp_path / "a")) is None


def test_exposures_are_exact_and_dark_or_white_pictures_are_left_alone():
    """A disc that covers a twentieth of a textured picture; a white one with a thin black line."""
    random, (row, column) = np.random.default_rng(0), np.mgrid[:64, :64]
    ground = random.uniform(40, 200, (64, 64, 3))
    at = 32 + 20 * np.cos(0.3 * np.arange(90))[:, None, None]
    disc = (column - at) ** 2 + (row - 40) ** 2 < 64
    exposure = 1 + 0.1 * np.sin(np.arange(90) / 9)
    frames = np.where(disc[..., None], 230.0, ground) * exposure[:, None, None, None] + random.normal(
        0, 3, (90, 64, 64, 3)
    )
    frames = np.clip(np.round(frames), 0, 255).astype(np.uint8)
    found = usual_of([frames]).exposures(frames)
    np.testing.assert_allclose(found / found.mean(axis=0), np.tile(exposure[:, None], 3) / exposure.mean(), rtol=3e-3)
    for level in (5.0, 250.0):
        picture = np.where(np.abs(row - at) < 1, 255 - level, level) + random.normal(0, 3, (90, 64, 64))
        plain = np.repeat(np.clip(picture, 0, 255).astype(np.uint8)[..., None], 3, axis=-1)
        assert made_alike([plain.copy()]) == 0


def test_neither_a_place_that_a_part_visits_nor_a_small_part_is_a_clock():
    """Next to a large part that moves: a place that differs in a third of the frames, a ball that swings a little."""
    time, (row, column) = np.arange(120), np.mgrid[:120, :160]
    bar = np.abs(column - 80 - 50 * np.sin(0.2 * time)[:, None, None]) + 0 * row < 4
    visited = (column > 10) & (column < 16) & (row > 10) & (row < 16) & (time % 30 < 10)[:, None, None]
    ball = (column - 20 - 4 * np.sin(0.3 * time)[:, None, None]) ** 2 + (row - 110) ** 2 < 5
    clock = (column > 10) & (column < 16) & (row > 10) & (row < 16) & ((row + column + time[:, None, None]) % 3 == 0)
    for small, found in ((visited, 0), (ball & (row > 0), 0), (clock, 1)):
        differs = (bar & (row > 40) & (row < 95)) | small
        assert len(overlays(differs, np.any(differs, axis=0))) == found


def test_pictures_are_larger_where_parts_are_small(tmp_path):
    """Discs of radius 12, 5 and 2.5 that swing through a picture of 300 x 300."""
    row, column = np.mgrid[:300, :300]
    angle = 1.2 * np.cos(2 * np.pi * np.arange(70) / 40)
    for radius, sides in ((12, 64), (5, 128), (2.5, None)):
        far = np.hypot(column - (150 + 150 * np.sin(angle))[:, None, None], row - (150 * np.cos(angle))[:, None, None])
        frames = np.repeat(np.where(far < radius, 20, 220).astype(np.uint8)[..., None], 3, axis=-1)
        path = video(tmp_path, frames, f"{radius}.mp4")
        if sides is None:
            with pytest.raises(KeycldError, match="too few to be followed: add --size"):
                import_clip(path, tmp_path / f"{radius}", constraints="pendulum", size=None)
            continue
        clip = import_clip(path, tmp_path / f"{radius}", constraints="pendulum", size=None)
        assert 0.6 * sides < clip.size <= sides and clip.size % 8 == 0
        assert open_data(clip.folder).train().image.shape[2:] == (clip.size, clip.size, 3)


def test_an_upright_video_of_a_long_pendulum_is_seen_from_end_to_end(tmp_path):
    """A bar of 130 pixels in a picture of 96 x 150: a square of 150, with the ground on both sides of the picture."""
    row, column = np.mgrid[:150, :96]
    angle = 0.25 * np.cos(2 * np.pi * np.arange(70) / 40)[:, None, None]
    along = (column - 48) * np.sin(angle) + (row - 8) * np.cos(angle)
    bar = (np.abs((column - 48) * np.cos(angle) - (row - 8) * np.sin(angle)) < 4) & (along > -4) & (along < 130)
    path = video(tmp_path, np.repeat(np.where(bar, 220, 90).astype(np.uint8)[..., None], 3, axis=-1))
    clip = import_clip(path, tmp_path / "a", constraints="pendulum", size=None)
    left, top, side, _ = clip.crop
    assert (left, top, side) == (-27, 0, 150)
    data = open_data(clip.folder)
    image, edge = data.train().image[0], round(27 * 64 / 150)
    for side in (image[:, :, : edge - 1], image[:, :, -edge + 1 :]):
        assert side.min() > 80 and side.max() < 100
    assert image[:, 55].max() > 180
    again = read(clip_file(path, tmp_path / "b.h5", data.attributes, 64))
    np.testing.assert_array_equal(again.image[0, : len(image)], image)


@pytest.mark.parametrize("rate", [Fraction(30_000, 1001), Fraction(60_000, 1001), Fraction(30)])
def test_every_frame_is_kept_up_to_the_most(rate):
    found = [_every(frames * float(1 / rate), rate) for frames in (60, MOST, MOST + 1, 2 * MOST, 2 * MOST + 1)]
    assert found == [1, 1, 2, 2, 3]


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
        (lambda: np.concatenate([swing(40), 255 - swing(50)]), "has a cut at 1.60 s: name the part before"),
    ],
    ids=["short", "still", "camera", "cut"],
)
def test_wrong_videos_are_refused_and_leave_nothing(tmp_path, frames, message):
    path = video(tmp_path, frames())
    with pytest.raises(KeycldError, match=message):
        import_clip(path, tmp_path / "a", constraints="pendulum")
    assert [each.name for each in tmp_path.iterdir()] == ["swing.mp4"]


def test_a_crop_without_motion_and_a_folder_in_use_are_refused(tmp_path, monkeypatch):
    path = video(tmp_path, swing())
    with pytest.raises(KeycldError, match="nothing moves in most frames within --crop 0 0 8 8 of .*swing.mp4: name"):
        import_clip(path, tmp_path / "a", constraints="pendulum", crop=(0, 0, 8, 8))
    with pytest.raises(KeycldError, match="'cartpole' is the name of a system"):
        import_clip(path, tmp_path / "cartpole", constraints="pendulum")
    import_clip(path, tmp_path / "b", constraints="pendulum", size=24)
    # Before it takes a minute to read a long video.
    monkeypatch.setattr("keycld.data.imports.clip.look_at", None)
    with pytest.raises(KeycldError, match="b already holds data"):
        import_clip(path, tmp_path / "b", constraints="pendulum", size=24)


def test_a_given_pivot_needs_a_given_crop(tmp_path):
    path, fixed = video(tmp_path, swing()), tmp_path / "fixed.toml"
    fixed.write_text('keypoints = ["ball"]\n[[constraint]]\nkind = "distance_to_point"\nkeypoint = "ball"\n')
    with pytest.raises(KeycldError, match=r"fixed.toml gives the pivot of 'ball' .*: add --crop .*\"unknown\""):
        import_clip(path, tmp_path / "a", constraints=fixed, size=24)
    import_clip(path, tmp_path / "a", constraints=fixed, size=24, crop=(32, 0, 96, 96))


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
    with pytest.raises(KeycldError, match="the model learned from other data: .*keycld data import"):
        clip_file(path, tmp_path / "b.h5", {"protocol": "import"}, 24)
    (tmp_path / "log.csv").write_text("time,angle")
    with pytest.raises(KeycldError, match="log.csv cannot be read as a video"):
        clip_file(tmp_path / "log.csv", tmp_path / "b.h5", {"protocol": "import"}, 24)
