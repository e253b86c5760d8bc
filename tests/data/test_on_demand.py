"""test_long is made when it is first needed: the file that would be made at once, by one process, resumed."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from keycld import KeycldError
from keycld._lock import locked
from keycld.cli.main import main
from keycld.data import check, make_data, open_data, sha256
from keycld.data.generate import make as make_module
from keycld.evaluation import protocols_for
from swing import Swing

RUNS = {"train": 1, "validation": 1, "test": 1, "test_long": 2}
# Of test_long, one run is a part.
SMALL = {"runs": RUNS, "frames": {"train": 4, "validation": 4, "test": 4, "test_long": 251}, "workers": 1}


@pytest.fixture(scope="module")
def at_once(tmp_path_factory):
    return make_data("pendulum", tmp_path_factory.mktemp("at_once") / "pendulum", all=True, **SMALL).folder


@pytest.fixture(scope="module")
def later(tmp_path_factory):
    """A set without its long test."""
    made = make_data("pendulum", tmp_path_factory.mktemp("later") / "pendulum", **SMALL)
    assert made.later == ("test_long",) and made.frames == 3 * 4 + 80
    return made.folder


@pytest.fixture
def folder(later, tmp_path):
    """A copy of that set, to complete."""
    return shutil.copytree(later, tmp_path / "pendulum")


def described(folder: Path) -> dict:
    figures = json.loads((folder / "statistics.json").read_text())
    return {name: figures[name] for name in ("splits", "recipe", "renderer", "frames_drawn")}


def test_the_file_is_the_same(folder, at_once, capsys):
    assert check(folder) == [] and not (folder / "test_long.h5").exists()
    assert "| `test_long.h5` | 2 × 251 | – |" in (folder / "README.md").read_text()
    before = {path.name: path.stat().st_mtime_ns for path in folder.glob("*.h5")}
    data = open_data(folder)
    assert "test_long" in data.splits
    found = [protocol.name for protocol in protocols_for(data, Swing.right())]
    assert found == ["test@4", "validation@4", "test_long@200", "test_long@251", "test_long@50-from-30"]
    said = capsys.readouterr().err
    assert f"making {folder}/test_long.h5, which is needed now: 2 × 251 frames" in said and "502/502" in said
    for path in at_once.glob("*.h5"):
        assert sha256(folder / path.name) == sha256(path)
    assert {name: (folder / name).stat().st_mtime_ns for name in before} == before
    assert check(folder) == [] and not (folder / ".partial").exists()
    # All but the seconds, also in the order of the files.
    assert json.dumps(described(folder)) == json.dumps(described(at_once))
    assert "first needed" not in (folder / "README.md").read_text()
    data.count("test_long")
    assert capsys.readouterr().err == ""


def test_all_completes_a_set(folder, at_once):
    made = make_data("pendulum", folder, all=True, **SMALL)
    assert made.fresh and made.frames == 502 and made.later == ()
    assert sha256(folder / "test_long.h5") == sha256(at_once / "test_long.h5") and check(folder) == []
    assert not make_data("pendulum", folder, all=True, **SMALL).fresh
    assert not make_data("pendulum", folder, **SMALL).fresh


def test_a_complete_set_stays_complete(at_once, tmp_path):
    """Also one that earlier versions made, which had no lock."""
    folder = shutil.copytree(at_once, tmp_path / "pendulum", ignore=shutil.ignore_patterns(".lock"))
    made = make_data("pendulum", folder, **SMALL)
    assert not made.fresh and made.later == () and not (folder / ".lock").exists()


def test_a_lost_file_is_made_again(at_once, tmp_path):
    folder = shutil.copytree(at_once, tmp_path / "pendulum")
    (folder / "test_long.h5").unlink()
    assert "lacks test_long.h5" in check(folder)[-1]
    shutil.copy(folder / "validation.h5", folder / "test.h5")
    assert make_data("pendulum", folder, **SMALL).frames == 502
    # The check-sums of the other files are not renewed.
    [problem] = check(folder)
    assert "test.h5 has changed" in problem


@pytest.mark.slow
def test_a_kill_loses_one_part_and_nothing_else(folder, at_once, capfd):
    call = f"from keycld.data import open_data; open_data({str(folder)!r}).path('test_long')"
    process = subprocess.Popen([sys.executable, "-c", call])
    deadline = time.monotonic() + 60
    while not list(folder.glob(".partial/test_long-*.h5")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert list(folder.glob(".partial/*-*.h5")) and not (folder / "test_long.h5").exists()
    data = open_data(folder)
    assert check(folder) == [] and data.count("test") == 1
    capfd.readouterr()
    # The command for the rest of the set continues what was begun.
    assert make_data("pendulum", folder, **SMALL).frames < 502
    assert sha256(folder / "test_long.h5") == sha256(at_once / "test_long.h5") and check(folder) == []


def test_a_kill_before_the_description(folder, at_once, monkeypatch):
    def dies(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("keycld.data.generate.job.describe_more", dies)
    with pytest.raises(KeyboardInterrupt):
        open_data(folder).path("test_long")
    monkeypatch.undo()
    assert check(folder) == [] and open_data(folder).count("test_long") == 2
    assert make_data("pendulum", folder, **SMALL).frames == 0
    assert described(folder)["splits"] == described(at_once)["splits"] and not (folder / ".partial").exists()


def test_a_second_process_waits(folder, at_once):
    call = f"from keycld.data import open_data; open_data({str(folder)!r}).path('test_long')"
    with locked(folder / ".lock"):
        process = subprocess.Popen([sys.executable, "-c", call], stderr=subprocess.PIPE, text=True)
        assert process.stderr is not None
        assert "waiting for another process that makes data in" in process.stderr.readline()
        shutil.copy(at_once / "test_long.h5", folder)
    assert "making" not in process.communicate(timeout=60)[1] and process.returncode == 0


def test_where_it_cannot_be_made(folder, tmp_path, monkeypatch, capsys):
    # Root may write everywhere, so that a folder without the permission proves nothing.
    monkeypatch.setattr(make_module.os, "access", lambda path, mode: False)
    assert main(["data", "show", str(folder), "--split", "test_long"]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert "may not be written: copy the folder" in line
    # The rest of the set needs no permission.
    assert open_data(folder).count("test") == 1
    assert not make_data("pendulum", folder, **SMALL).fresh
    monkeypatch.undo()

    path = folder / "statistics.json"
    path.write_text(path.read_text().replace('"system": "pendulum"', '"system": "bead"'))
    with pytest.raises(KeycldError, match="no system 'bead' is registered: import the module"):
        open_data(folder).path("test_long")
    path.unlink()  # as in data from elsewhere
    assert main(["data", "show", str(folder), "--split", "test_long"]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert "has no test_long.h5, only sweeps, test, train, validation: make or add it" in line
    assert not (folder / "test_long.h5").exists() and os.listdir(folder).count(".partial") == 0
