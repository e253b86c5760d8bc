"""A training whose clips several devices share: the losses of one device, and checkpoints for any number of them."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
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

EXCHANGES = r"""
import json, re
import jax, jax.numpy as jnp
from keycld.data import Resident
from keycld.mechanics import Constraints, DistanceToPoint
from keycld.models import Scene, config_for
from keycld.training.devices import use_devices
from keycld.training.step import Fixed, initial_progress, step_keys, take_steps

def exchanges(config, inputs):
    "Count the operations of a step of the last stage by which devices exchange numbers, outside of loops and within."
    devices, scene = use_devices(4), Scene(32, 32, inputs, 20, 0.05, 8)
    stage = next(stage for stage in config.stages(scene) if stage.name in ("joint", "train"))
    data = Resident(jnp.zeros((8, 20, 32, 32, 3), jnp.uint8), jnp.zeros((8, inputs)), jnp.asarray(0.05, jnp.float32))
    progress, rest = initial_progress(stage, config.build(scene, jax.random.key(0)))
    chosen, fixed, progress = devices.everywhere(
        ((step_keys(0, 0), stage.rates(), stage.numbers), (rest, data), progress)
    )
    program = take_steps.lower(Fixed(stage.rule, devices, 1, chosen, *fixed), progress).compile().compiled.as_text()
    loops, computation, found = set(re.findall(r"body=%?([\w.-]+)", program)), "", [0, 0]
    for line in program.splitlines():
        if begin := re.match(r"(?:ENTRY )?%?([\w.-]+) \(.*{$", line):
            computation = begin[1]
        found[computation in loops] += bool(re.search(r" all-(reduce|gather|to-all)(-start)?\(", line))
    return found

law = Constraints(("ball",), (DistanceToPoint("ball"),))
keycld = config_for("keycld", "fast", constraints=law, width=8, groups=2, joint={"horizons": (16,), "batch": 4})
small = {"channels": 4, "hidden": 8, "depth": 1, "latent": 4}
hgn = config_for("hgn", "released", **small, batch=8, targets=10, frames_at_once=9)
ar = config_for("ar", "fast", channels=4, batch=8)
print(json.dumps([exchanges(keycld, 1), exchanges(hgn, 0), exchanges(ar, 0)]))
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


@pytest.mark.slow
def test_devices_exchange_numbers_outside_of_loops_alone():
    """Else they would send the whole gradient for every frame of a motion and every chunk of frames."""
    flags = {"XLA_FLAGS": f"{os.environ['XLA_FLAGS']} {SIMULATED}"}
    told = subprocess.run([sys.executable, "-c", EXCHANGES], env=os.environ | flags, capture_output=True, text=True)
    assert told.returncode == 0, told.stderr[-2000:]
    for outside, within in json.loads(told.stdout):
        assert outside > 0 and within == 0


def test_a_processor_counts_as_many_devices():
    script = "from keycld.training.devices import use_devices; print(use_devices(3).count, use_devices(1).count)"
    told = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert told.stdout.split() == ["3", "1"]


@pytest.mark.parametrize(
    ("count", "fix"), [(0, ""), (2, ": take fewer, or simulate more with XLA_FLAGS=--xla_force_host_.*_count=2")]
)
def test_a_number_of_devices_that_are_not_there_is_refused(count, fix):
    jax.devices()  # Until a process computes, its processor counts as many devices.
    words = rf"--devices is 1, the only one of this machine \(cpu\), not {count}{fix}\.$"
    with pytest.raises(KeycldError, match=words):
        use_devices(count)
