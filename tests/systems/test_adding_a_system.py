"""A system is added by one file: those of docs/systems.md, and one in a new folder of the package."""

import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import keycld.systems
from keycld import KeycldError
from keycld._entry_points import load_entry_points
from keycld.data import make_data, open_data
from keycld.systems import AbstractMujocoSystem, Conditions, get, names, register, render
from keycld.systems.registry import _SYSTEMS

PAGE = (Path(__file__).parents[2] / "docs" / "systems.md").read_text().split("## Add a system")[1]
BLOCKS = re.findall(r"```(?:python|xml)\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.fixture
def forget(monkeypatch):
    """Systems that a test registers are unknown afterwards."""
    names()  # a module registers its system once, when it is first imported
    monkeypatch.setattr("keycld.systems.registry._SYSTEMS", dict(_SYSTEMS))


def load(folder, monkeypatch, name, text):
    (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(folder)
    importlib.import_module(name)


@pytest.mark.slow
def test_the_pages_hamiltonian(tmp_path, monkeypatch, forget):
    load(tmp_path, monkeypatch, "double_well", BLOCKS[0])
    system = get("toy/double_well")
    recording = system.record(range(20), 64, "priors-released", "default")
    energy = system.all_conserved(recording.state, recording.parameters)
    assert np.abs(energy - energy[:, :1]).max() < 1e-7
    # Below the barrier a particle stays on its side.
    q, trapped = recording.state[..., 0], energy[:, 0] < 0.25
    assert 0 < trapped.sum() < 20 and np.all(np.ptp(np.sign(q[trapped]), axis=1) == 0)
    make_data(
        "toy/double_well", tmp_path / "data", runs={"train": 3, "test": 1}, frames={"train": 4, "test": 4}, workers=1
    )
    assert open_data(tmp_path / "data").test().image.shape == (1, 4, 32, 32, 3)


def test_the_pages_mujoco_system(tmp_path, monkeypatch, forget):
    (tmp_path / "bead.xml").write_text(BLOCKS[1])
    load(tmp_path, monkeypatch, "bead", BLOCKS[2])
    system = get("bead")
    run = system.record(np.random.RandomState(1), 20, Conditions())
    # m = 1 kg and gear 1, so the acceleration in m/s² is the input in newtons.
    np.testing.assert_allclose(run.state_derivative[:, 1], run.input[0], atol=1e-12)
    image = render(system, run.state[:1]).image[0].astype(int)
    red = np.argwhere(image[..., 0] > image[..., 2] + 60).mean(axis=0)
    wanted = system.landmarks(run.state[0])[0]
    np.testing.assert_allclose(red[::-1] / 31.5 - 1.0, wanted * np.array([1.0, -1.0]), atol=0.05)


def test_a_system_without_a_method_is_refused_by_name(tmp_path, monkeypatch, forget):
    unfinished = BLOCKS[2].partition("    def sweeps")[0].replace("Bead(", "Unfinished(")
    with pytest.raises(KeycldError, match="the system Unfinished in unfinished lacks sweeps: write what is missing"):
        load(tmp_path, monkeypatch, "unfinished", unfinished)


def test_an_installed_package_adds_a_system(tmp_path, monkeypatch, forget):
    (tmp_path / "double_well.py").write_text(BLOCKS[0])
    installed = tmp_path / "wells-0.1.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: wells\nVersion: 0.1\n")
    (installed / "entry_points.txt").write_text("[keycld.systems]\nwell = double_well\n")
    monkeypatch.delitem(sys.modules, "double_well", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    load_entry_points.cache_clear()
    assert "toy/double_well" in names()
    unfinished = BLOCKS[2].partition("    def sweeps")[0]
    for text, reason in (("import nothing_of", "No module named 'nothing_of'"), (unfinished, "the .* lacks sweeps")):
        (tmp_path / "double_well.py").write_text(text)
        monkeypatch.delitem(sys.modules, "double_well", raising=False)
        load_entry_points.cache_clear()
        with pytest.raises(keycld.KeycldError, match=rf"'well' of double_well cannot be loaded \({reason}\): fix or"):
            names()


def test_a_new_folder_is_found(tmp_path, monkeypatch, forget):
    folder = tmp_path / "wells"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "double_well.py").write_text(BLOCKS[0])
    monkeypatch.setattr(keycld.systems, "__path__", [*keycld.systems.__path__, str(tmp_path)])
    assert "toy/double_well" in names()


def test_one_class_is_enough(forget):
    @register
    class Heavy(type(get("pendulum"))):
        name = "heavy"

    assert isinstance(get("heavy"), AbstractMujocoSystem) and "heavy" in names()


def test_a_missing_model_file_is_named(forget):
    @register
    class Lost(type(get("pendulum"))):
        name = "lost"

    with pytest.raises(keycld.KeycldError, match=r"no model file .*lost\.xml"):
        get("lost").simulate(np.zeros(2), np.zeros(1), 1)
