"""The original files: bytes made with Google's own protocol buffers and check-sums from golden data of the suite."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from keycld import KeycldError
from keycld.data import check, import_suite, open_data, with_derivative
from keycld.data.imports.tfrecord import Feature, count_records, read_examples, read_features

GOLDEN = Path(__file__).parent / "golden" / "tfrecord"
SUITE = Path(__file__).parent.parent / "systems" / "golden" / "suite"
NAMES = ("double_pendulum_colors", "matching_pennies")


@pytest.mark.parametrize("name", NAMES)
def test_arrays(name):
    features, golden = read_features(GOLDEN / name / "features.txt"), np.load(SUITE / f"{name}.npz")
    assert features["x"] == Feature((4, 4), np.dtype("float64"))
    examples = list(read_examples(GOLDEN / name / "train.tfrecord", features))
    assert len(examples) == count_records(GOLDEN / name / "train.tfrecord") == 2
    for i, example in enumerate(examples):
        np.testing.assert_array_equal(example["x"], golden["x"][i, :4])
        np.testing.assert_array_equal(example["image"][0], golden["image"][i, 0])
        for key in ("m_1", "g"):
            if f"param_{key}" in golden:
                assert example[f"other/{key}"][0] == golden[f"param_{key}"][i]
        if "color_index" in golden:
            np.testing.assert_array_equal(example["other/color_index"][0], golden["color_index"][i])
            np.testing.assert_array_equal(example["other/offset"][0], golden["offset"][i])


@pytest.mark.parametrize("name", NAMES)
def test_a_folder_becomes_a_data_set(name, tmp_path):
    source = tmp_path / name
    shutil.copytree(GOLDEN / name, source)
    if name == "matching_pennies":
        shutil.copytree(source, tmp_path / f"{name}_long_trajectory")
    out = import_suite(source, tmp_path / "out")
    assert check(out) == [] and not (out / ".partial").exists()
    data, golden = open_data(out), np.load(SUITE / f"{name}.npz")
    assert (data.count("train"), data.count("validation"), data.count("test")) == (1, 1, 1)
    assert ("test_long" in data.splits) == (name == "matching_pennies")
    np.testing.assert_array_equal(data.test().state[0], golden["x"][2, :4])
    np.testing.assert_array_equal(data.validation().image[0, 0], golden["image"][1, 0])
    assert data.system.endswith(name) and data.dt == golden["dt"]
    with pytest.raises(KeycldError, match="already holds data"):
        import_suite(source, out)


def test_the_folder_one_is_in(tmp_path, monkeypatch):
    monkeypatch.chdir(shutil.copytree(GOLDEN / "matching_pennies", tmp_path / "matching_pennies"))
    assert open_data(import_suite(".", tmp_path / "out")).system.endswith("matching_pennies")


def test_derivatives_are_ours(tmp_path):
    """Those of the download lack the friction."""
    shutil.copytree(GOLDEN / "double_pendulum_colors", tmp_path / "double_pendulum_colors_friction_dt_0_05")
    out = import_suite(tmp_path / "double_pendulum_colors_friction_dt_0_05", tmp_path / "out")
    train = open_data(out).train()
    assert train.state_derivative is None and train.attributes["system"] == "toy/double_pendulum_colors_friction"
    assert with_derivative(train).state_derivative.shape == train.state.shape and train.input.shape == (1, 0)


def test_what_is_not_of_the_suite(tmp_path):
    shutil.copytree(GOLDEN / "matching_pennies", tmp_path / "matching_penny")
    with pytest.raises(KeycldError, match="did you mean 'matching_pennies'"):
        import_suite(tmp_path / "matching_penny", tmp_path / "out")
    (tmp_path / "pendulum").mkdir()
    with pytest.raises(KeycldError, match="features.txt"):
        import_suite(tmp_path / "pendulum", tmp_path / "out")
    (tmp_path / "pendulum" / "features.txt").write_text("x (4, 4) float64\n")
    with pytest.raises(KeycldError, match="not of the form"):
        read_features(tmp_path / "pendulum" / "features.txt")


@pytest.mark.parametrize("cut", [5, 11, 40, -1, -9])
def test_truncated_files(cut, tmp_path):
    whole = (GOLDEN / "matching_pennies" / "train.tfrecord").read_bytes()
    (tmp_path / "a").write_bytes(whole[:cut])
    features = read_features(GOLDEN / "matching_pennies" / "features.txt")
    with pytest.raises(KeycldError, match="copy it again"):
        list(read_examples(tmp_path / "a", features))


@pytest.mark.parametrize("position", range(12, 60, 3))
def test_damaged_records_are_named_or_pass(position, tmp_path):
    """Never another error than the one that tells how to fix it."""
    whole = bytearray((GOLDEN / "matching_pennies" / "test.tfrecord").read_bytes())
    whole[position] ^= 0xFF
    (tmp_path / "a").write_bytes(bytes(whole))
    features = read_features(GOLDEN / "matching_pennies" / "features.txt")
    try:
        assert len(list(read_examples(tmp_path / "a", features))) == 1
    except KeycldError as error:
        assert "record 0 is damaged" in str(error)
