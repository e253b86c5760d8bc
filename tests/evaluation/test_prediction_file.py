import h5py
import numpy as np
import pytest

import scenes
from keycld import KeycldError
from keycld.data import write
from keycld.evaluation import predict_batch, predict_file
from swing import Still, Swing, without_pictures


@pytest.fixture
def source(tmp_path):
    write(tmp_path / "data.h5", scenes.disc_pendulum(5, 12, seed=4))
    return tmp_path / "data.h5"


def test_every_trajectory_is_predicted(source, tmp_path):
    done = []
    out = predict_file(Swing.right(), source, tmp_path / "new" / "out.h5", progress=lambda k, n: done.append(k))
    data = scenes.disc_pendulum(5, 12, seed=4)
    direct = predict_batch(Swing.right(), data.image[:, :2].astype(np.float32) / 255, data.dt, data.input, 12)
    with h5py.File(out) as file:
        assert file["image"].shape == (5, 12, 16, 16, 3) and file["image"].dtype == np.float32
        assert file["keypoints"].shape == (5, 12, 1, 2) and file["keypoints"].dtype == np.float32
        np.testing.assert_allclose(file["image"][...], direct.frames, atol=1e-5)
        np.testing.assert_allclose(file["keypoints"][...], direct.keypoints, atol=1e-5)
        assert np.mean((file["image"][...] - data.image / 255.0) ** 2) < 1e-3
        np.testing.assert_array_equal(file["time"][...], data.time)
        assert file.attrs["given_frames"] == 2 and file.attrs["system"] == "disc"
    assert done[-1] == 5 * 12


def test_pictures_after_the_given_ones_change_nothing(source, tmp_path):
    one = predict_file(Swing.right(), source, tmp_path / "one.h5")
    with h5py.File(source, "a") as file:
        image = file["image"][...]
        image[:, 2:] = 0
        file["image"][...] = image
        file["state"][...] = 0
    two = predict_file(Swing.right(), source, tmp_path / "two.h5")
    with h5py.File(one) as a, h5py.File(two) as b:
        np.testing.assert_array_equal(a["image"][...], b["image"][...])


def test_frames_in_the_middle_are_given(source, tmp_path):
    """From frames 5 and 6 a reversible model knows what was before; one that is not reversible refuses."""
    truth = scenes.disc_pendulum(5, 12, seed=4).image / 255.0
    with h5py.File(predict_file(Swing.right(), source, tmp_path / "out.h5", first=5)) as file:
        assert np.mean((file["image"][...] - truth) ** 2) < 1e-3
        assert file.attrs["first_given_frame"] == 5
    with pytest.raises(KeycldError, match="cannot run backward, so the first given frame is 0, not 5"):
        predict_file(Still(), source, tmp_path / "out.h5", first=5)
    with pytest.raises(KeycldError, match="frames 11 to 12 are to be given, but .* frames 0 to 11"):
        predict_file(Swing.right(), source, tmp_path / "out.h5", first=11)


def test_a_model_without_keypoints_writes_none(source, tmp_path):
    with h5py.File(predict_file(Still(), source, tmp_path / "out.h5")) as file:
        assert "image" in file and "keypoints" not in file


def test_mistakes_leave_no_file(source, tmp_path):
    out = tmp_path / "out.h5"
    write(tmp_path / "bare.h5", without_pictures(scenes.disc_pendulum(2, 6, seed=0)))
    with pytest.raises(KeycldError, match="no /image"):
        predict_file(Swing.right(), tmp_path / "bare.h5", out)
    with pytest.raises(KeycldError, match="the data itself"):
        predict_file(Swing.right(), source, source)
    with pytest.raises(KeycldError, match="needs 2 given frames"):
        predict_file(Swing.right(), source, out, given=1)
    with pytest.raises(KeycldError, match="bare.h5 is no file of predictions, and stays as it is"):
        predict_file(Swing.right(), source, tmp_path / "bare.h5")
    (tmp_path / "file").write_text("")
    with pytest.raises(KeycldError, match="file is no file of predictions"):
        predict_file(Swing.right(), source, tmp_path / "file")
    with pytest.raises(KeycldError, match="choose a folder"):
        predict_file(Swing.right(), source, tmp_path / "file" / "out.h5")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bare.h5", "data.h5", "file"]
