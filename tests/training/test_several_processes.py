"""A training that several processes share, as they would on several machines."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from keycld._errors import KeycldError
from keycld._lock import locked
from keycld.models import config_for
from keycld.training import join, load_run, train

SMALL = {"channels": 4, "hidden": 8, "depth": 1, "latent": 4, "batch": 4, "steps": 4, "targets": 6}
SCRIPT = """
import shutil, sys
from pathlib import Path
from keycld import KeycldError
from keycld.models import config_for
from keycld.training import join, train
from scenes import TINY
from test_several_processes import SMALL

root, made, port, number = *map(Path, sys.argv[1:3]), *sys.argv[3:]
join(f"localhost:{port}", 2, int(number))
hgn = config_for("hgn", "released", **SMALL)
train(made / "mine", root / "hgn", hgn, log_every=1, checkpoint_seconds=0.0, keep=100)
# KeyCLD after a fit between its steps, from a checkpoint of one process.
train(made / "mine", root / "keycld", config_for("keycld", "fast", **TINY), log_every=2)
for out, seed in (("refused", int(number)), ("held", 0)):
    try:
        train(made / "mine", root / out, hgn, seed=seed)
    except KeycldError as error:
        print(error)
"""


def start(script: str, *words: object) -> subprocess.Popen[str]:
    """Start a process that finds the modules of the tests."""
    folders = [str(Path(__file__).parent), str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    here = {**os.environ, "PYTHONPATH": os.pathsep.join(folders)}
    command = [sys.executable, "-c", script, *map(str, words)]
    return subprocess.Popen(command, env=here, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("localhost", 0))
        return free.getsockname()[1]


def losses(run):
    return [json.loads(line)["loss"] for line in (run / "metrics.jsonl").read_text().splitlines() if "loss" in line]


@pytest.mark.slow
def test_two_processes_give_the_losses_of_one(tmp_path, trained):
    """One of them writes; its checkpoints resume in one process, and those of one process in two."""
    copy = tmp_path / "keycld"
    subprocess.run(["cp", "-r", trained / "whole", copy], check=True)
    (copy / "checkpoints" / "latest").write_text("02-joint-000004")
    port = free_port()
    with locked(tmp_path / "held" / ".lock"):
        pair = [start(SCRIPT, tmp_path, trained, port, number) for number in range(2)]
        said = [process.communicate() for process in pair]
    assert [process.returncode for process in pair] == [0, 0], said
    config = config_for("hgn", "released", **SMALL)
    train(trained / "mine", tmp_path / "one", config, log_every=1, checkpoint_seconds=0.0, keep=100)
    assert losses(tmp_path / "hgn") == pytest.approx(losses(tmp_path / "one"), rel=1e-5)
    (tmp_path / "hgn" / "checkpoints" / "latest").write_text("00-train-000002")
    train(trained / "mine", tmp_path / "hgn", config, log_every=1)
    assert losses(tmp_path / "hgn") == pytest.approx(losses(tmp_path / "one"), rel=1e-5)
    # As in test_devices.py.
    assert losses(copy) == pytest.approx(losses(trained / "whole"), rel=2e-2)
    assert load_run(copy)[1].devices == 1
    for out, _ in said:
        assert "process 1 has other settings or data than process 0: start all with the same command" in out
    assert "another process is training in" in said[0][0] and "process 0 could not open the run" in said[1][0]
    assert "trained" not in said[1][0] and "joint" in said[0][1] and "joint" not in said[1][1]


@pytest.mark.parametrize(
    ("coordinator", "processes", "process", "sentence"),
    [
        ("localhost:1", None, None, "localhost:1 needs --processes, the number of all processes, and --process"),
        ("localhost:1", 2, 2, "--process is at least 0 and below --processes, not 2 of 2"),
        ("localhost", 2, 1, "--coordinator is ADDRESS:PORT of process 0, or auto, not 'localhost'"),
    ],
)
def test_numbers_of_processes_are_checked(coordinator, processes, process, sentence):
    with pytest.raises(KeycldError, match=sentence):
        join(coordinator, processes, process)
