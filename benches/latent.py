"""How a training step of HGN grows, in units of a matrix product of the same run.

With target frames, all of which are rendered, with the windows of a batch, the numbers of the latent vector, and the
devices that share a batch. These are simulated on the same cores: they show what sharing costs or gains. Prints JSON,
and with `--plot FILE` draws the growth.
"""

import argparse
import functools
import json
import sys

import jax
import jax.numpy as jnp
from step import matrix_product, save_growth, timed

from keycld import use_compile_cache
from keycld.data import Resident
from keycld.models import Scene, config_for
from keycld.training.devices import use_devices

GROWTH = {"targets": (15, 30, 60), "batch": (4, 8, 16), "latent": (32, 64, 128), "devices": (1, 2, 4)}
USUAL = {"targets": 30, "batch": 4, "latent": 32, "devices": 1}
GIVEN, SIDE, DT = 5, 32, 0.05


@functools.cache
def step_time(targets, batch, latent, devices):
    """Return the time of a step of the last stage of `fast`, with random pictures."""
    print(f"a step with {targets=} {batch=} {latent=} {devices=}", file=sys.stderr, flush=True)
    frames = GIVEN + targets
    scene = Scene(SIDE, SIDE, 0, frames, DT, 32)
    config = config_for("hgn", "fast", rendered=0, targets=targets, batch=batch, latent=latent)
    image = jax.random.bits(jax.random.key(1), (32, frames, SIDE, SIDE, 3), jnp.uint8)
    data = Resident(image, jnp.zeros((32, 0)), jnp.asarray(DT, jnp.float32))
    model = config.build(scene, jax.random.key(0))
    return timed(config.stages(scene)[-1], model, data, use_devices(devices), steps=1)


def main():
    """Time the growth, and print JSON."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--plot", metavar="FILE", help="PNG file for the growth")
    plot = arguments.parse_args().plot
    # Before JAX begins to compute.
    jax.config.update("jax_num_cpu_devices", max(GROWTH["devices"]))
    use_compile_cache()
    unit = matrix_product()
    growth = {
        name: {size: round(step_time(**(USUAL | {name: size})) / unit, 1) for size in sizes}
        for name, sizes in GROWTH.items()
    }
    if plot:
        save_growth(plot, growth, {})
    print(json.dumps({"bench": "latent", "unit_ms": round(1e3 * unit, 2), "growth": growth}))


if __name__ == "__main__":
    main()
