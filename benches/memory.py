"""Training steps a second with freed memory kept by the process, compared with the default of the C library.

Steps of the joint stage on random frames. Both alternate in one run, so that the speed of the machine cancels in the
ratio. Prints JSON.
"""

import json
import statistics
import time

import jax
import jax.numpy as jnp

from keycld.data import Resident
from keycld.models import Scene, config_for
from keycld.systems import get
from keycld.training.memory import keep_freed_memory
from keycld.training.step import initial_progress, make_step

ROUNDS, SETTLE, CALLS, STEPS, FRAMES = 7, 1, 2, 25, 50


def main():
    """Time both alternately and print medians."""
    system = get("acrobot")
    scene = Scene(64, 64, 2, FRAMES, system.dt, 8)
    config = config_for("keycld", "fast").completed(system)
    image = jax.random.bits(jax.random.key(0), (8, FRAMES, 64, 64, 3), jnp.uint8)
    data = Resident(image, jnp.zeros((8, 2)), jnp.asarray(system.dt, jnp.float32))
    number, model = 2, config.build(scene, jax.random.key(1))
    stage = config.stages(scene)[number]
    progress, rest = initial_progress(stage, model)
    run = make_step(stage, number, 0, STEPS)
    progress, _ = run((rest, data), progress)  # the first call compiles
    seconds = {"default": [], "kept": []}
    for _ in range(ROUNDS):
        for name in seconds:
            accepted = keep_freed_memory(name == "kept")
            for k in range(SETTLE + CALLS):
                if k == SETTLE:
                    jax.block_until_ready(progress.parameters)
                    before = time.perf_counter()
                progress, _ = run((rest, data), progress)
            jax.block_until_ready(progress.parameters)
            seconds[name].append(time.perf_counter() - before)
    rate = {name: CALLS * STEPS / statistics.median(values) for name, values in seconds.items()}
    result = {"bench": "memory", "steps_per_second": {k: round(v, 1) for k, v in rate.items()}, "told": accepted}
    print(json.dumps(result | {"ratio": round(rate["kept"] / rate["default"], 2)}))


if __name__ == "__main__":
    main()
