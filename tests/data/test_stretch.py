"""Which part of a video shows the mechanism alone and in motion."""

import numpy as np
import pytest

from keycld import KeycldError
from keycld.data import changes_of, import_clip, open_data
from keycld.data.imports.stretch import undisturbed
from keycld.drawing import save_movie

DT, ROWS, COLUMNS = 1 / 30, 90, 120
ROW, COLUMN = np.mgrid[:ROWS, :COLUMNS]


def ball(x, y=45.0, radius=8.0):
    return (COLUMN - np.asarray(x)[:, None, None]) ** 2 + (ROW - np.asarray(y)) ** 2 < radius**2


def pictures(*shapes):
    random = np.random.default_rng(0)
    grey = np.where(np.any(shapes, axis=0), 210.0, 70 + 20 * np.sin(COLUMN / 6.0))
    return np.clip(grey + random.normal(0, 2, grey.shape), 0, 255).astype(np.uint8)


def swinging(frames, amplitude=25.0, damping=0.05, period=1.5):
    t = DT * np.arange(frames)
    return 60 + amplitude * np.exp(-damping * t) * np.cos(2 * np.pi * t / period)


def arm(x, height=14):
    """From the right edge to x, for each frame."""
    return (np.asarray(x)[:, None, None] < COLUMN) & (abs(ROW - 45) < height)


def found(grey):
    return undisturbed(grey, np.abs(grey.astype(float) - np.median(grey, axis=0)) > 15, DT)


HELD = np.concatenate([np.full(40, 75.0), swinging(200, amplitude=15.0)])
LEAVING = np.concatenate([np.full(40, 78.0), 78 + 4 * np.arange(200)])


def test_the_hand_that_releases_a_pendulum_is_not_part_of_it():
    first, last = found(pictures(ball(HELD), arm(LEAVING)))
    assert 51 <= first <= 58 and last == 240  # the arm is out of the picture from frame 51


def test_a_small_hand_that_is_there_once_is_left_out():
    """It makes a fifth more of the picture differ: fewer than a passer-by, who may come at any time."""
    string = (abs(COLUMN - 60 - (HELD[:, None, None] - 60) * ROW / 45) < 3) & (ROW < 45)
    hand = arm(np.maximum(LEAVING, 110.0)) & (LEAVING[:, None, None] < 118)
    first, last = found(pictures(ball(HELD), string, hand))
    assert 50 <= first <= 58 and last == 240


def test_a_passer_by_leaves_the_longer_part():
    x = 10.0 + 3 * (np.arange(240) - 150)
    walker = (abs(COLUMN - x[:, None, None]) < 12) & (ROW > 20)
    first, last = found(pictures(ball(swinging(240)), walker))
    assert first == 0 and 135 <= last <= 143  # in the picture from frame 143


def test_a_mechanism_that_is_held_still_begins_when_it_moves():
    first, last = found(pictures(ball(HELD)))
    assert 40 <= first <= 44 and last == 240


@pytest.mark.parametrize(
    "x",
    [
        swinging(240),
        swinging(240, amplitude=65.0, damping=0.3),  # leaves the picture in its first swings
        swinging(240, amplitude=65.0, damping=0.0),  # in all of them
        swinging(240, damping=1.5),  # comes to rest
        swinging(240, period=8.0),  # released from rest, slowly
        swinging(240, amplitude=3.0),
    ],
)
def test_motions_of_the_mechanism_itself_are_kept(x):
    assert found(pictures(ball(x))) == (0, 240)


def test_a_hanging_part_that_touches_the_edge_and_a_flash_are_kept():
    x = swinging(240)
    rod = abs(COLUMN - (60 + (x[:, None, None] - 60) * ROW / 80)) < 3
    flash = np.zeros((240, ROWS, COLUMNS), bool)
    flash[100:103, 5:60] = True
    assert found(pictures(rod)) == (0, 240) and found(pictures(ball(x), flash)) == (0, 240)


def test_a_camera_that_is_touched_at_the_end_is_no_cut(tmp_path):
    grey = pictures(ball(swinging(150)))
    for k, shift in enumerate((9, 21, 30, 45), 146):
        grey[k] = np.roll(grey[k], (shift // 3, shift), axis=(0, 1))
    save_movie(tmp_path / "end.mp4", np.repeat(grey[..., None], 3, axis=-1), fps=30.0, scale=1)
    clip = import_clip(tmp_path / "end.mp4", tmp_path / "a", constraints="spring", size=32)
    assert sum(clip.frames) == pytest.approx(143, abs=1)
    with pytest.raises(KeycldError, match="has a cut at 4"):
        import_clip(tmp_path / "end.mp4", tmp_path / "b", constraints="spring", size=32, skip=0.0)


def test_the_part_is_cut_out_and_said(tmp_path):
    grey = pictures(ball(HELD), arm(LEAVING))
    save_movie(tmp_path / "hand.mp4", np.repeat(grey[..., None], 3, axis=-1), fps=30.0, scale=1)
    clip = import_clip(tmp_path / "hand.mp4", tmp_path / "a", constraints="spring", size=32)
    assert clip.crop[2] < 80 and sum(clip.frames) == pytest.approx(185, abs=4)
    (said,) = changes_of(open_data(tmp_path / "a").attributes)
    assert said.startswith("only seconds 1.8 to 8.0 are used")
    whole = import_clip(tmp_path / "hand.mp4", tmp_path / "b", constraints="spring", size=32, skip=0.0)
    assert whole.crop[2] > 80 and sum(whole.frames) == 240
    assert changes_of(open_data(tmp_path / "b").attributes) == []
    short = np.repeat(grey[:95, ..., None], 3, axis=-1)
    save_movie(tmp_path / "short.mp4", short, fps=30.0, scale=1)
    with pytest.raises(KeycldError, match="that shows the mechanism alone and in motion has .. frames, but 60"):
        import_clip(tmp_path / "short.mp4", tmp_path / "c", constraints="spring", size=32)


@pytest.mark.parametrize(("amplitude", "out"), [(75.0, True), (40.0, False)])
def test_a_part_that_leaves_the_picture_is_refused_if_it_is_to_be_followed(tmp_path, amplitude, out):
    frames = pictures(ball(swinging(240, amplitude, damping=0.0)))
    save_movie(tmp_path / "swing.mp4", np.repeat(frames[..., None], 3, axis=-1), fps=30, scale=1)

    def made(name, **options):
        return import_clip(tmp_path / "swing.mp4", tmp_path / name, constraints="pendulum", **options)

    if not out:
        assert made("whole").frames == (144, 16, 80)
        return
    with pytest.raises(KeycldError, match="beyond its left and right edge, in [23].% of the frames"):
        made("refused")
    assert list(tmp_path.iterdir()) == [tmp_path / "swing.mp4"]
    made("cropped", crop=(30, 0, 90, 90))
