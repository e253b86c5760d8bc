"""Files with states and without pictures, as the published suites are stored: rendered a block at a time."""

import dataclasses

import h5py
import numpy as np
import pytest

from keycld.data import DataSet, Trajectories, read, with_pictures, write
from keycld.evaluation import evaluate, predict_file, protocols_for, references
from keycld.systems import get
from swing import Still

SYSTEM = get("toy/mass_spring")
PLAN = SYSTEM.protocols[0]


def recorded(numbers, frames):
    recording = SYSTEM.record(numbers, frames, PLAN, "default")
    return Trajectories(
        time=recording.time,
        input=np.zeros((len(numbers), 0), np.float32),
        state=recording.state,
        parameters=recording.parameters,
        attributes={
            "schema_version": 1, "system": SYSTEM.name, "dt": SYSTEM.dt, "state_names": SYSTEM.state_names,
            "units": SYSTEM.units, "protocol": PLAN, "renderer": SYSTEM.renderer,
            "renderer_version": SYSTEM.renderer_version,
        },
    )  # fmt: skip


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("states")
    for name, numbers in (("train", range(4)), ("validation", range(4, 6)), ("test", range(6, 9))):
        write(folder / f"{name}.h5", recorded(numbers, 80))
    return DataSet(folder, None)


def test_scores_are_those_of_the_pictures(data, tmp_path):
    """Stored states and stored pictures of the same trajectories score the same under the suite's protocol."""
    for name in data.splits:
        write(tmp_path / f"{name}.h5", with_pictures(data.split(name)))
    (protocol,) = protocols_for(data, Still())
    assert protocol.name == "test@80-priors" and protocol.part == (64, 80)
    rendered, stored = (evaluate(Still(), each, protocol) for each in (data, DataSet(tmp_path, None)))
    np.testing.assert_array_equal(rendered.errors, stored.errors)
    assert rendered.scores == stored.scores
    assert rendered.scores["n"] == 3 and rendered.scores["vpt"]["0.025"]["mean"] < 1.0
    assert references(data).sources["retrieved_frames"] == 4 * 80


def test_only_the_given_frames_are_rendered_for_a_prediction(data, tmp_path):
    path = data.path("test")
    out = predict_file(Still(), path, tmp_path / "out.h5", given=5)
    truth = with_pictures(read(path)).image
    with h5py.File(out) as file:
        np.testing.assert_allclose(file["image"][:, 0], truth[:, 0] / 255.0, atol=1e-6)
        assert file["image"].shape == truth.shape and file["input"].shape == (3, 0)
        assert file.attrs["given_frames"] == 5
    spoiled = read(path)
    state = spoiled.state.copy()
    state[:, 5:] = 0.0
    write(tmp_path / "spoiled.h5", dataclasses.replace(spoiled, state=state))
    again = predict_file(Still(), tmp_path / "spoiled.h5", tmp_path / "again.h5", given=5)
    with h5py.File(out) as a, h5py.File(again) as b:
        np.testing.assert_array_equal(a["image"][...], b["image"][...])
