"""Keypoint tracks as other programs read them."""

import csv
import json

import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.data.export import lerobot
from keycld.data.export.lerobot import write_lerobot
from keycld.data.export.tracks import KeypointTracks, write_csv, write_time_series


@pytest.fixture
def tracks():
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-1, 1, (3, 20, 2, 2)), rng.uniform(-1, 1, (3, 20, 1))
    return KeypointTracks(("elbow", "tip"), x, u, 1 / 30, ("torque",))


def test_csv_has_a_row_a_frame_and_a_column_a_coordinate(tracks, tmp_path):
    write_csv(tmp_path / "tracks.csv", tracks)
    rows = list(csv.DictReader((tmp_path / "tracks.csv").read_text().splitlines()))
    assert len(rows) == 60 and list(rows[0])[:4] == ["recording", "time", "elbow_x", "elbow_y"]
    last = rows[-1]
    assert float(last["tip_y"]) == pytest.approx(tracks.x[2, 19, 1, 1])
    assert float(last["time"]) == pytest.approx(19 / 30)
    assert float(last["torque"]) == pytest.approx(tracks.u[2, 19, 0])


def test_time_series_are_the_sensors_of_the_exported_model(tracks, tmp_path):
    """The layout that mujoco.sysid stores: times, data, and a mapping from names to columns."""
    paths = write_time_series(tmp_path, tracks, metres=0.5)
    assert [path.name for path in paths] == ["recording_000.npz", "recording_001.npz", "recording_002.npz"]
    with np.load(paths[1], allow_pickle=False) as stored:
        kind, columns = json.loads(str(stored["signal_mapping"]))["tip"]
        assert kind == 0
        np.testing.assert_allclose(stored["data"][:, columns][:, [0, 2]], 0.5 * tracks.x[1, :, 1])
        np.testing.assert_allclose(stored["times"], tracks.time)


def test_mujoco_sysid_reads_the_time_series(tracks, tmp_path):
    sysid = pytest.importorskip("mujoco.sysid")
    path = write_time_series(tmp_path, tracks)[0]
    series = sysid.TimeSeries.load_from_disk(path)
    assert series.signal_mapping["tip"][0] is sysid.SignalType.MjSensor


def test_a_lerobot_data_set(tracks, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    write_lerobot(tmp_path, tracks, "a double pendulum swings")
    info = json.loads((tmp_path / "meta" / "info.json").read_text())
    assert info["codebase_version"] == "v3.0" and info["fps"] == 30 and info["total_frames"] == 60
    assert info["features"]["action"]["names"] == ["torque"]
    table = parquet.read_table(tmp_path / info["data_path"].format(chunk_index=0, file_index=0)).to_pydict()
    assert table.keys() == info["features"].keys()
    assert table["episode_index"][20] == 1 and table["frame_index"][20] == 0
    np.testing.assert_allclose(table["observation.state"][20], tracks.x[1, 0].reshape(-1), rtol=1e-6)
    episodes = parquet.read_table(tmp_path / "meta" / "episodes" / "chunk-000" / "file-000.parquet").to_pydict()
    assert episodes["dataset_to_index"] == [20, 40, 60] and episodes["tasks"][0] == ["a double pendulum swings"]


def test_a_lerobot_data_set_of_something_else_stays(tracks, tmp_path):
    pytest.importorskip("pyarrow")
    write_lerobot(tmp_path, tracks, "a double pendulum swings")
    write_lerobot(tmp_path, tracks, "it swings again")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file()}
    other = KeypointTracks(("cart", "tip"), tracks.x, tracks.u, tracks.dt, tracks.inputs)
    with pytest.raises(KeycldError, match="holds another LeRobot data set, and stays as it is: choose another --out"):
        write_lerobot(tmp_path, other, "a cart and its pole")
    assert all(path.read_bytes() == contents for path, contents in before.items())


def test_a_folder_with_other_files_gets_no_lerobot_data_set(tracks, tmp_path):
    pytest.importorskip("pyarrow")
    (tmp_path / "train.h5").write_bytes(b"data")
    with pytest.raises(KeycldError, match="holds other files, and stays as it is: choose another --out"):
        write_lerobot(tmp_path, tracks, "a double pendulum swings")
    assert [path.name for path in tmp_path.iterdir()] == ["train.h5"]


def test_an_interrupted_lerobot_export_is_made_by_the_same_call(tracks, tmp_path, monkeypatch):
    pytest.importorskip("pyarrow")

    def ended(path, text):
        hidden = path.with_name(f".{path.name}.1234567@elsewhere.partial")
        hidden.mkdir()
        (hidden / path.name).write_text(text[:10])
        raise KeyboardInterrupt

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(lerobot, "write_text", ended)
        write_lerobot(tmp_path / "out", tracks, "a double pendulum swings")
    write_lerobot(tmp_path / "out", tracks, "a double pendulum swings")
    assert json.loads((tmp_path / "out" / "meta" / "info.json").read_text())["total_frames"] == 60
