"""A training whose clips several devices share: the losses of one device, and checkpoints for any number of them."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from keycld._errors import KeycldError
from keycld.training.devices import use_devices

SIMULATED = "--xla_force_host_platform_device_count=4"
SCRIPT = """
import json, shutil, sys
from pathlib import Path
from keycld import KeycldError
from keycld.models import config_for
from keycld.training import train
from scenes import TINY

root, made = map(Path, sys.argv[1:])
data = made / "mine"

def losses(run):
    return [json.loads(line)["loss"] for line in (run / "metrics.jsonl").read_text().splitlines() if "loss" in line]

def from_step(name, source, checkpoint, config, log_every, devices):
    run = shutil.copytree(source, root / name)
    (run / "checkpoints" / "latest").write_text(checkpoint)
    train(data, run, config, devices=devices, log_every=log_every)
    return losses(run)

small = {"channels": 4, "hidden": 8, "depth": 1, "latent": 4, "batch": 4, "steps": 4, "targets": 6}
# A loss with a state, and frames in chunks that do not divide evenly.
hgn = config_for("hgn", "released", **small, objective="geco", frames_at_once=9)
for count in (1, 4):
    train(data, root / f"hgn-{count}", hgn, devices=count, log_every=1, checkpoint_seconds=0.0, keep=100)
found = {count: losses(root / f"hgn-{count}") for count in (1, 4)}
resumed = from_step("hgn-2", root / "hgn-4", "00-train-000002", hgn, 1, 2)
# KeyCLD after a fit between its steps, from a checkpoint of one device.
keycld = config_for("keycld", "fast", **TINY)
last = from_step("keycld-2", made / "whole", "02-joint-000004", keycld, 2, 2)
refused = []
for count in (3, 5):
    try:
        train(data, root / "refused", hgn, devices=count)
    except KeycldError as error:
        refused.append(str(error))
print(json.dumps([found[1], found[4], resumed, losses(made / "whole"), last, refused]))
"""


@pytest.mark.slow
def test_several_devices_give_the_losses_of_one(tmp_path, trained):
    """In a process of its own, where the processor stands for four devices."""
    here = {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])}
    flags = {"XLA_FLAGS": f"{os.environ['XLA_FLAGS']} {SIMULATED}"}
    command = [sys.executable, "-c", SCRIPT, str(tmp_path), str(trained)]
    answer = subprocess.run(command, env={**os.environ, **here, **flags}, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    one, four, resumed, whole, last, refused = json.loads(answer.stdout.splitlines()[-1])
    assert len(one) == 4 and four == pytest.approx(one, rel=1e-5) and resumed == pytest.approx(one, rel=1e-5)
    # A least-squares fit of a model that has learned nothing lets rounding grow: to 0.006 in programs of level 0.
    assert len(whole) == len(last) and last == pytest.approx(whole, rel=2e-2)
    assert "takes 4 clips a step, which 3 devices cannot share equally: set its batch to a multiple of 3" in refused[0]
    assert "--devices is a number from 1 to 4, those of this machine (cpu), not 5: take fewer, or sim" in refused[1]
    assert not (tmp_path / "refused").exists()


@pytest.mark.parametrize(
    ("count", "fix"), [(0, ""), (2, ": take fewer, or simulate more with XLA_FLAGS=--xla_force_host_.*_count=2")]
)
def test_a_number_of_devices_that_are_not_there_is_refused(count, fix):
    words = rf"--devices is 1, the only one of this machine \(cpu\), not {count}{fix}\.$"
    with pytest.raises(KeycldError, match=words):
        use_devices(count)
