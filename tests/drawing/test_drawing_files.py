import gc
import subprocess

import imageio.v3
import imageio_ffmpeg
import numpy as np
import pytest

from keycld import KeycldError
from keycld._files import replacing
from keycld.drawing import load_image, save_image, save_movie


def read_mp4(path, height, width):
    """The decoded frames, and what ffmpeg says about the file."""
    gc.collect()  # a writer that left a pipe open would be noticed here
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    answer = subprocess.run(command, capture_output=True, check=True)
    return np.frombuffer(answer.stdout, np.uint8).reshape(-1, height, width, 3), answer.stderr.decode()


@pytest.fixture
def frames():
    """A bright square that moves to the right over a grey ground."""
    movie = np.full((12, 16, 20, 3), 90, np.uint8)
    for t in range(12):
        movie[t, 4:10, t : t + 6] = (230, 120, 30)
    return movie


def test_a_png_holds_the_same_pixels(tmp_path, frames):
    save_image(tmp_path / "new" / "a.png", frames[3])
    np.testing.assert_array_equal(imageio.v3.imread(tmp_path / "new" / "a.png"), frames[3])


def test_an_mp4_shows_the_motion(tmp_path, frames):
    save_movie(tmp_path / "a.mp4", frames, fps=25, scale=4)
    read, told = read_mp4(tmp_path / "a.mp4", 64, 80)
    assert len(read) == 12
    assert np.abs(read[:, 2::4, 2::4].astype(int) - frames).mean() < 6
    assert "Video: h264" in told and "yuv420p" in told and "25 fps" in told and "80x64" in told


def test_an_odd_size_is_made_even_for_mp4(tmp_path, frames):
    save_movie(tmp_path / "a.mp4", frames[:, :15, :19], scale=1)
    assert "20x16" in read_mp4(tmp_path / "a.mp4", 16, 20)[1]


def test_a_gif_loops_forever_at_its_speed(tmp_path, frames):
    save_movie(tmp_path / "a.gif", frames, fps=25, scale=2)
    read = imageio.v3.imread(tmp_path / "a.gif")
    assert read.shape == (12, 32, 40, 3)
    assert np.abs(read[:, ::2, ::2].astype(int) - frames).mean() < 2
    meta = imageio.v3.immeta(tmp_path / "a.gif")
    assert meta["duration"] == 40 and meta["loop"] == 0


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_mistakes_are_named(tmp_path, frames):
    with pytest.raises(KeycldError, match=r"\.mp4 or \.gif, not in '\.avi'"):
        save_movie(tmp_path / "a.avi", frames)
    with pytest.raises(KeycldError, match="at least one frame"):
        save_movie(tmp_path / "a.gif", frames[:0])
    (tmp_path / "file").write_text("")
    with pytest.raises(KeycldError, match=r"the picture .*/file cannot be read \(it is no PNG or JPEG\): save it"):
        load_image(tmp_path / "file")
    with pytest.raises(KeycldError, match="choose a folder that you may write to"):
        save_image(tmp_path / "file" / "a.png", frames[0])
