"""Time of a training step of `fast` by its parts, and how it grows, in units of a matrix product of the same run.

One unit is the time of a float32 product of two 1024 × 1024 matrices, so figures of different machines compare. Prints
JSON, and with `--plot FILE` writes the growth as a figure.
"""

import argparse
import functools
import json
import statistics
import sys
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld import use_compile_cache
from keycld.data import Resident
from keycld.drawing import Curve, curves_figure, save_figure
from keycld.mechanics import Constraints, DistanceToPoint, FixedDistance
from keycld.models import Scene, config_for
from keycld.models.keycld.model import KeyCLD
from keycld.stages import muon, warmup_cosine
from keycld.training.devices import Devices
from keycld.training.step import initial_progress, make_step

ROUNDS, STEPS, DT = 5, 10, 0.02
USUAL = {"frames": 16, "side": 64, "keypoints": 2, "horizon": 50}
GROWTH = {"frames": (8, 16, 32), "side": (32, 64, 96), "keypoints": (1, 2, 4), "horizon": (25, 50, 100)}


def seconds(function, *arguments, repeats=STEPS):
    """Return the median time of a call, after one that compiles."""
    jax.block_until_ready(function(*arguments))
    found = []
    for _ in range(ROUNDS):
        before = time.perf_counter()
        for _ in range(repeats):
            jax.block_until_ready(function(*arguments))
        found.append((time.perf_counter() - before) / repeats)
    return statistics.median(found)


def chain(count):
    """Return the constraints of a chain of `count` links."""
    names = tuple("abcdefgh"[:count])
    links = tuple(FixedDistance(*pair) for pair in zip(names[:-1], names[1:], strict=True))
    return Constraints(names, (DistanceToPoint(names[0]), *links))


def prepared(frames, side, keypoints, horizon):
    """Return the last training stage of `fast`, a model and random data of these sizes."""
    scene = Scene(side, side, 1, horizon, DT, 8)
    config = config_for(
        "keycld", "fast", constraints=chain(keypoints), joint={"horizons": (horizon,), "batch": frames // 8}
    )
    model = config.build(scene, jax.random.key(0))
    image = jax.random.bits(jax.random.key(1), (8, horizon, side, side, 3), jnp.uint8)
    stage = next(stage for stage in config.stages(scene) if stage.name == "joint")
    return stage, model, Resident(image, jnp.zeros((8, 1)), jnp.asarray(DT, jnp.float32))


@functools.cache
def step_time(**sizes):
    """Return the time of one step, of 10 in a dispatch."""
    print(f"a step with {sizes}", file=sys.stderr, flush=True)
    return timed(*prepared(**sizes))


def timed(stage, model, data, devices=Devices(), steps=STEPS):  # noqa: B008
    """Return the median time of one step, of several in a dispatch."""
    progress, rest = initial_progress(stage, model)
    run = make_step(stage, 3, 0, steps, devices)
    fixed, progress = devices.everywhere((rest, data)), devices.everywhere(progress)
    progress, _ = jax.block_until_ready(run(fixed, progress))
    found = []
    for _ in range(ROUNDS):
        before = time.perf_counter()
        progress, _ = jax.block_until_ready(run(fixed, progress))
        found.append((time.perf_counter() - before) / steps)
    # Programs take memory maps, of which a process has 65,530.
    jax.clear_caches()
    return statistics.median(found)


def matrix_product():
    """Return the time of the unit."""
    matrix = jax.random.normal(jax.random.key(0), (1024, 1024))
    return seconds(jax.jit(jnp.matmul), matrix, matrix)


def save_growth(plot, growth, amounts):
    """Draw the time of a step against each size, as a multiple of its smallest value.

    Args:
        plot: PNG file.
        growth: for each size, times by its values.
        amounts: functions of the values that a time should be proportional to, where not the values themselves.
    """
    curves = []
    for name, found in growth.items():
        sizes = np.array(list(found))
        amount = amounts.get(name, lambda sizes: sizes)(sizes)
        label = f"{name}: {', '.join(map(str, sizes))}"
        curves.append(Curve(amount / amount[0], np.array(list(found.values())), label))
    beside = " (side: pixels)" if "side" in growth else ""
    figure = curves_figure(curves, f"times the smallest one{beside}", "time of a step, matrix products")
    figure.axes[0].set_ylim(bottom=0.0)
    save_figure(plot, figure)


def part_times():
    """Return the time of each part with its gradient, compiled alone."""
    stage, model, data = prepared(**USUAL)
    assert isinstance(model, KeyCLD)
    keys = jax.random.split(jax.random.key(2))
    sample = jax.jit(functools.partial(stage.sampler, data))
    clips = sample(keys[0], jnp.array(0))
    frames = clips.frames.reshape(-1, *clips.frames.shape[2:])
    points = jax.random.uniform(keys[1], (len(frames), USUAL["keypoints"], 2)) - 0.5
    u = clips.u[0]

    def roll_out(dynamics, first):
        given = jnp.stack([first, first])
        state = model.initial_state(dynamics, given, data.dt, u)
        return dynamics.rollout(state, u, data.dt, USUAL["horizon"] - 1).x

    def gradient(function):
        return eqx.filter_jit(eqx.filter_grad(lambda part, inputs: jnp.sum(function(part, inputs) ** 2)))

    parameters = eqx.filter((model.estimator, model.renderer), eqx.is_inexact_array)
    optimiser = muon(warmup_cosine(1e-3, 100))
    observed = gradient(lambda part, frames: jax.vmap(part)(frames).keypoints)
    rendered = gradient(lambda part, points: jax.vmap(part)(points))
    rolled = gradient(lambda part, first: jax.vmap(functools.partial(roll_out, part))(first))
    return {
        "sampler": seconds(sample, keys[0], jnp.array(1)),
        "estimator": seconds(observed, model.estimator, frames),
        "renderer": seconds(rendered, model.renderer, points),
        "roll-outs": seconds(rolled, model.dynamics, points[: len(points) // 2].reshape(-1, 2 * USUAL["keypoints"])),
        "optimiser": seconds(jax.jit(optimiser.update), parameters, optimiser.init(parameters), parameters),
    }


def main():
    """Time parts and growth, and print JSON."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--plot", metavar="FILE", help="PNG file for the growth")
    plot = arguments.parse_args().plot
    # A program of these sizes compiles for half a minute.
    use_compile_cache()
    unit = matrix_product()
    result = {"bench": "step", "unit_ms": round(1e3 * unit, 2), "gflops": round(2 * 1024**3 / unit / 1e9)}
    result["parts"] = {name: round(value / unit, 2) for name, value in part_times().items()}
    growth = {
        name: {size: round(step_time(**(USUAL | {name: size})) / unit, 2) for size in sizes}
        for name, sizes in (GROWTH.items() if plot else ())
    }
    if plot:
        result["growth"] = growth
        # A picture of twice the side has four times the pixels.
        save_growth(plot, growth, {"side": np.square})
    else:
        result["step"] = round(step_time(**USUAL) / unit, 2)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
