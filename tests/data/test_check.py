"""Files spoiled on purpose: the message names the problem, its place and how to fix it."""

import dataclasses
import json

import h5py
import numpy as np
import pytest
from sample import sample

from keycld import KeycldError
from keycld.data import check, read, write


def remove(name):
    def spoil(file):
        del file[name]

    return spoil


def replace(name, make):
    def spoil(file):
        value = make(np.asarray(file[name]))
        del file[name]
        file[name] = value

    return spoil


def put(name, index, value):
    def spoil(file):
        array = np.asarray(file[name])
        array[index] = value
        file[name][...] = array

    return spoil


def attribute(name, value):
    def spoil(file):
        if value is None:
            del file.attrs[name]
        else:
            file.attrs[name] = value

    return spoil


def both(*spoils):
    def spoil(file):
        for each in spoils:
            each(file)

    return spoil


SPOILED = {
    "no image": (remove("image"), "field '/image' is missing: add it"),
    "no time": (remove("time"), "field '/time' is missing"),
    "float image": (replace("image", lambda a: a / 255.0), "'/image' is float64, but must be uint8"),
    "grey image": (replace("image", lambda a: a[..., 0]), "'/image' has the shape (3, 5, 8, 8)"),
    "image short": (replace("image", lambda a: a[:2]), "with N = 3 as in '/input'"),
    "image frames": (replace("image", lambda a: a[:, :4]), "T = 5 as in '/time'"),
    "text input": (replace("input", lambda a: a.astype("S4")), "must hold real numbers"),
    "complex state": (replace("state", lambda a: a + 1j), "'/state' is complex128"),
    "flat input": (replace("input", lambda a: a[:, 0]), "'/input' has the shape (3,)"),
    "input names": (attribute("input_names", ["a"]), "'input_names' has 1 entries, but '/input' has 2"),
    "input frames": (replace("input", lambda a: np.zeros((3, 4, 2), np.float32)), "'/input' has the shape (3, 4, 2)"),
    "time per run": (replace("time", lambda a: np.tile(a, (3, 1))), "'/time' has the shape (3, 5)"),
    "no input, image short": (
        both(remove("input"), replace("image", lambda a: a[:2])),
        "'/state' has the shape (3, 5, 4), but must be [2, 5, d]",
    ),
    "state short": (replace("state", lambda a: a[:, :3]), "'/state' has the shape (3, 3, 4)"),
    "derivative": (replace("state_derivative", lambda a: a[..., :2]), "a '/state' of the same shape"),
    "parameter": (replace("parameters/seed", lambda a: a[:2]), "'/parameters/seed' has the shape (2,)"),
    "names": (attribute("state_names", ["a", "b"]), "'state_names' has 2 entries, but '/state' has 4"),
    "nan state": (put("state", (2, 4, 1), np.nan), "'/state'[2, 4, 1] is nan (1 such values)"),
    "nan input": (put("input", (1, 0), np.nan), "'/input'[1, 0] is nan"),
    "infinite input": (put("input", (1, 1), np.inf), "'/input'[1, 1] is inf"),
    "nan time": (put("time", 3, np.nan), "'/time'[3] is nan"),
    "time back": (put("time", 2, 0.05), "'/time' falls or stops from frame 1 (0.2 s) to 2 (0.05 s)"),
    "dt": (attribute("dt", 0.05), "but the attribute 'dt' is 0.05 s"),
    "uneven time": (put("time", 4, 0.56), "'/time' steps by 0.16 s from frame 3 to 4"),
    "no dt": (attribute("dt", None), "root attribute 'dt' is missing: add it (seconds between frames)"),
    "negative dt": (attribute("dt", -0.1), "must be a positive number of seconds, not -0.1."),
    "text dt": (attribute("dt", "fast"), "must be a positive number of seconds"),
    "no system": (attribute("system", None), "root attribute 'system' is missing"),
    "no version": (attribute("schema_version", None), "'schema_version' is missing"),
    "new version": (attribute("schema_version", 99), "'schema_version' is 99, but this keycld reads 1"),
}


@pytest.mark.parametrize("case", SPOILED)
def test_what_is_wrong_and_where(tmp_path, case):
    spoil, words = SPOILED[case]
    path = tmp_path / "a.h5"
    write(path, sample())
    assert check(path) == []
    with h5py.File(path, "r+") as file:
        spoil(file)
    problems = check(path)
    assert len(problems) == 1 and words in problems[0] and str(path) in problems[0]
    with pytest.raises(KeycldError) as caught:
        read(path, images=False)
    assert str(caught.value) == problems[0]


@pytest.mark.parametrize("spoil", [remove("input"), replace("input", lambda a: a[:, :0])])
def test_undriven_files_need_no_input(tmp_path, spoil):
    for name in ("train", "validation", "test"):
        write(tmp_path / f"{name}.h5", sample())
        with h5py.File(tmp_path / f"{name}.h5", "r+") as file:
            spoil(file)
    assert check(tmp_path) == []
    assert read(tmp_path / "train.h5").input.shape == (3, 0)


def test_a_file_without_recordings(tmp_path):
    write(tmp_path / "a.h5", sample())
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        replace("input", lambda a: a[:0])(file)
    assert "holds no recording" in check(tmp_path / "a.h5")[0]


def test_driven_and_undriven_files_do_not_mix(tmp_path):
    write(tmp_path / "train.h5", sample())
    write(tmp_path / "test.h5", dataclasses.replace(sample(), input=np.zeros((3, 0), np.float32)))
    differs, lacks = check(tmp_path)
    assert "lacks validation.h5" in lacks
    assert "train.h5 differs from test.h5 in 'inputs': 2, not 0" in differs


def test_several_problems_are_all_listed(tmp_path):
    path = tmp_path / "a.h5"
    write(path, sample())
    with h5py.File(path, "r+") as file:
        del file["time"], file.attrs["dt"]
    assert len(check(path)) == 2
    with pytest.raises(KeycldError, match="and 1 more"):
        read(path)


@pytest.mark.parametrize("kept", [0.0, 0.3, 0.95])
def test_a_truncated_file(tmp_path, kept):
    path = tmp_path / "a.h5"
    write(path, sample())
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    assert "truncated or damaged: copy or make it again" in check(path)[0]
    with pytest.raises(KeycldError, match="truncated"):
        read(path)


def test_damaged_pictures_are_located(tmp_path):
    path = tmp_path / "a.h5"
    write(path, sample())
    with h5py.File(path) as file:
        chunk = file["image"].id.get_chunk_info(1)
    damaged = bytearray(path.read_bytes())
    for offset in range(chunk.byte_offset + 40, chunk.byte_offset + 80):
        damaged[offset] ^= 0xFF
    path.write_bytes(damaged)
    assert "recording 1 cannot be decoded" in check(path)[0]
    with pytest.raises(KeycldError, match="recording 1 cannot be decoded"):
        read(path)
    assert len(read(path, images=False)) == 3


def test_random_damage_is_never_a_crash(tmp_path):
    path = tmp_path / "a.h5"
    write(path, sample())
    whole = path.read_bytes()
    random = np.random.RandomState(0)
    for _ in range(60):
        damaged = bytearray(whole)
        for offset in random.randint(0, len(whole), 30):
            damaged[offset] = random.randint(256)
        path.write_bytes(damaged)
        assert isinstance(check(path), list)


def test_not_a_data_file(tmp_path):
    (tmp_path / "swing.mp4").write_bytes(b"\x00\x00\x00\x20ftypisom" + bytes(1000))
    problem = "swing.mp4 is no HDF5 file: name an .h5 file, or make data of a video with `keycld data import`"
    assert problem in check(tmp_path / "swing.mp4")[0]
    assert "there is no file" in check(tmp_path / "b.h5")[0]
    with pytest.raises(KeycldError, match="is a folder"):
        read(tmp_path)


def test_a_folder(tmp_path):
    assert "holds no .h5 file" in check(tmp_path)[0]
    for name in ("train", "validation", "test"):
        write(tmp_path / f"{name}.h5", sample())
    assert check(tmp_path) == []
    with h5py.File(tmp_path / "validation.h5", "r+") as file:
        attribute("dt", 2 * file.attrs["dt"])(file)
        replace("time", lambda time: 2 * time)(file)
    (differs,) = check(tmp_path)
    assert "validation.h5 differs from test.h5 in 'dt'" in differs
    (tmp_path / "validation.h5").unlink()
    [lacks] = check(tmp_path)
    assert "lacks validation.h5: make the data again, or add the file." in lacks
    write(tmp_path / "validation.h5", sample())
    (tmp_path / "constraints.toml").write_text("keypoints = [")
    [toml] = check(tmp_path)
    assert "constraints.toml is not valid TOML" in toml
    (tmp_path / "constraints.toml").unlink()
    figures = {"trajectories": 3, "frames": 5, "bytes": 1, "sha256": "0"}
    described = {"splits": dict.fromkeys(("train", "test_long"), figures)}
    (tmp_path / "statistics.json").write_text(json.dumps(described))
    changed, lacks = check(tmp_path)
    assert "train.h5 has changed" in changed and "lacks test_long.h5" in lacks
    (tmp_path / "statistics.json").write_text("{")
    assert "damaged" in check(tmp_path)[0]
