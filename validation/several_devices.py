"""One training, shared by devices or by processes: the losses of one device, and the throughput.

`python validation/several_devices.py [--counts 1,2,4] [--steps 20] [--out FILE.json]` simulates so many devices on this
machine, then starts two processes that share each batch by `jax.distributed`. Ends with code 1 if a loss differs by
more than 1e-5 of itself. All devices are the same processor cores here: what is measured is what sharing costs, or
gains where one device leaves a core idle.
"""

import argparse
import json
import os
import socket
import subprocess
import sys
import time

MODEL = {"channels": 16, "hidden": 32, "depth": 2, "latent": 8, "batch": 16, "targets": 16, "rendered": 4}
TRAJECTORIES, FRAMES, SIZE = 32, 40, 32
TOLERANCE = 1e-5


def train(devices: int, steps: int, process: int, processes: int, port: int) -> dict:
    """Take the steps with all devices of all processes, and return the losses and the rate of the later half."""
    import jax

    if processes > 1:
        jax.config.update("jax_cpu_collectives_implementation", "gloo")
        jax.distributed.initialize(f"localhost:{port}", processes, process)
    import equinox as eqx
    import jax.numpy as jnp
    import numpy as np
    from jax.sharding import Mesh

    from keycld.data import Resident, Windows
    from keycld.models import Scene, config_for
    from keycld.training.devices import Devices
    from keycld.training.step import initial_progress, make_step

    found = jax.devices()
    assert len(found) == devices, f"{len(found)} devices instead of {devices}"
    shared = Devices() if devices == 1 else Devices(Mesh(np.array(found), ("clips",)))
    config = config_for("hgn", "released", **MODEL)
    scene = Scene(SIZE, SIZE, 0, FRAMES, 0.05, TRAJECTORIES)
    # Every process makes the same data and the same weights from the same seeds.
    image = np.random.default_rng(0).integers(0, 256, (TRAJECTORIES, FRAMES, SIZE, SIZE, 3), np.uint8)
    data = Resident(jnp.asarray(image), jnp.zeros((TRAJECTORIES, 0)), jnp.array(0.05))
    (stage,) = config.stages(scene)
    assert isinstance(stage.sampler, Windows)
    progress, rest = initial_progress(stage, config.build(scene, jax.random.key(0)))
    run = make_step(stage, 0, 0, 1, shared)
    fixed, progress = shared.everywhere((rest, data)), shared.everywhere(progress)
    losses, since = [], 0.0
    for step in range(steps):
        if step == steps // 2:
            since = time.monotonic()
        progress, terms = run(fixed, progress)
        losses.append(float(shared.here(terms)["loss"][0]))
    rate = (steps - steps // 2) * stage.sampler.batch / (time.monotonic() - since)
    weights = [np.asarray(leaf) for leaf in jax.tree.leaves(shared.here(progress.parameters)) if eqx.is_array(leaf)]
    return {"losses": losses, "windows_a_second": rate, "norm": float(sum(np.sum(each**2) for each in weights))}


def start(devices: int, steps: int, process: int = 0, processes: int = 1, port: int = 0) -> subprocess.Popen:
    """Start a process with its part of the devices."""
    flags = f"--xla_force_host_platform_device_count={devices // processes}"
    here = {"XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {flags}", "JAX_PLATFORMS": "cpu"}
    arguments = [str(each) for each in (devices, steps, process, processes, port)]
    command = [sys.executable, __file__, "--work", *arguments]
    return subprocess.Popen(command, env={**os.environ, **here}, stdout=subprocess.PIPE, text=True)


def outcome(process: subprocess.Popen) -> dict:
    """Return what a process prints at its end."""
    text, _ = process.communicate()
    if process.returncode:
        raise SystemExit(f"a process ended with code {process.returncode}")
    return json.loads(text.splitlines()[-1])


def main() -> int:
    """Compare simulated devices and two processes with one device."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", default="1,2,4", help="numbers of simulated devices")
    parser.add_argument("--steps", type=int, default=20, help="optimiser steps of each training")
    parser.add_argument("--out", help="JSON file for the outcome")
    parser.add_argument("--work", nargs=5, type=int, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.work:
        print(json.dumps(train(*chosen.work)))
        return 0
    counts = [int(each) for each in chosen.counts.split(",")]
    found = {f"{count} devices": outcome(start(count, chosen.steps)) for count in counts}
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    pair = [start(2, chosen.steps, k, 2, port) for k in range(2)]
    found["2 processes"], other = (outcome(process) for process in pair)
    assert other["losses"] == found["2 processes"]["losses"] and other["norm"] == found["2 processes"]["norm"]
    first, worst = next(iter(found.values())), 0.0
    for name, each in found.items():
        off = max(abs(a - b) / abs(b) for a, b in zip(each["losses"], first["losses"], strict=True))
        each["difference"], worst = off, max(worst, off)
        print(f"{name:12} {each['windows_a_second']:8.2f} windows/s, losses differ by {off:.1e} at most")
    if chosen.out:
        with open(chosen.out, "w") as file:
            json.dump({"command": " ".join(sys.argv), "model": MODEL, "found": found}, file, indent=1)
    return int(worst > TOLERANCE)


if __name__ == "__main__":
    sys.exit(main())
