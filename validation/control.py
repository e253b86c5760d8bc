"""Scores of control from pixels: energy shaping, other laws, too few or too weak inputs, noise, roll-outs of the model.

python validation/control.py NAME RUN [--only EXPERIMENT ...]     results/control/NAME.json

RUN is a run folder or a trained model of the package. An experiment that the file holds for the same weights and
settings is skipped, so the same command resumes a killed one. Times depend on other work of the machine, so its load is
stored with them.
"""

import argparse
import dataclasses
import hashlib
import json
import math
import os
import sys
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld._files import aside_of
from keycld.benchmarks.results import read_json, write_json
from keycld.cli.control import summary_of
from keycld.control import ControlConfig, Disturbance, Imagination, Plant, goal_of, law_named, swing_up, upright_picture
from keycld.control.outcome import HOLD
from keycld.systems import get
from keycld.training import Counted, environment, load_run, run_folder

# The inputs of `under`: too weak to lift the links directly, or one input for two degrees of freedom.
UNDER = {
    "pendulum": {"limit": 1.0},
    "cartpole": {"limit": 3.0, "actuators": ("force",)},
    "acrobot": {"limit": 3.0, "actuators": ("elbow_torque",)},
}
ROLL_OUTS, STEPS, REPEATS = (1, 100, 10_000), 100, 5


def configs(system, seed):
    """Return the closed-loop runs by experiment."""
    full = ControlConfig(law=law_named("shaping", {"kp": 5.0, "kd": 2.0}), trials=100, seconds=10.0, seed=seed)
    few = dataclasses.replace(full, trials=25)
    under = ControlConfig(law=law_named("mpc"), trials=50, seconds=20.0, seed=seed, **UNDER[system])
    return {
        "full": full,
        "clipped3": dataclasses.replace(full, limit=3.0),
        "paper": dataclasses.replace(full, law=law_named("paper", {"kp": 5.0, "kd": 2.0})),
        "differences": dataclasses.replace(full, estimator="differences"),
        "under": under,
        "under-zero": dataclasses.replace(under, law=law_named("zero")),
        "under-random": dataclasses.replace(under, law=law_named("random")),
        "noise": dataclasses.replace(few, disturbance=Disturbance(noise=0.1)),
        "dropped": dataclasses.replace(few, disturbance=Disturbance(dropped=0.2)),
    }


EXPERIMENTS = (*configs("pendulum", 0), "imagination")


def closed_loop_scores(model, system, config, settings, workers):
    """Return the scores of one experiment, with the values of single trials condensed."""
    result = swing_up(
        model,
        system,
        config.epsilon,
        None,
        settings,
        input_names=config.input_names,
        progress=Counted("control"),
        workers=workers,
    )
    print(summary_of(result.scores), flush=True)
    scores = {name: value for name, value in result.scores.items() if name not in settings.as_dict()}
    success, settled = scores.pop("success"), scores.pop("settled_seconds")
    tilts = scores.pop("worst_tilt_last_second_degrees")
    kept = [seconds for seconds, good in zip(settled, success, strict=True) if good]
    return {
        "successes": scores.pop("successes"),
        "held_a_second": held_a_second(result),
        "failed_trials": np.flatnonzero(~success),
        "settled_seconds": {"median": np.median(kept), "last": np.max(kept)} if kept else None,
        "worst_tilt_last_second_degrees": {"median": np.median(tilts), "largest": np.max(tilts)},
        **scores,
    }


def held_a_second(result):
    """Return the trials that keep the goal for a second at any time, and the median time of the first such second.

    `successes` asks for the last second of the run instead.
    """
    last = max(1, round(HOLD / result.scores["dt"]))
    whole = np.asarray(np.lib.stride_tricks.sliding_window_view(result.arrays["good"], last, axis=1).all(axis=-1))
    held = whole.any(axis=1)
    # good[k] belongs to the state after frame k.
    first = (whole.argmax(axis=1)[held] + 1) * result.scores["dt"]
    return {
        "successes": held.sum(),
        "failed_trials": np.flatnonzero(~held),
        "from_seconds_median": np.median(first) if len(first) else None,
    }


def imagination(model, system, epsilon, seed):
    """Measure steps a second of the model in parallel roll-outs under random inputs, without compilation."""
    limit, inputs = 3.0, len(system.input_names)
    random = np.random.RandomState(seed)
    positions = np.stack([system.positions(random, slider_limit=1.0) for _ in range(100)])
    with Plant(system, np.concatenate([positions, np.zeros_like(positions)], axis=1), workers=1) as plant:
        frames = jnp.asarray(plant.look(), jnp.float32) / 255.0
    poses = jax.jit(jax.vmap(lambda frame: model.observe(frame).keypoints.reshape(-1)))(frames)
    world = Imagination.of(model, system.dt, poses, goal_of(model, upright_picture(system), epsilon), limit)

    def roll_out(key):
        reset, inputs_key = jax.random.split(key)
        us = jax.random.uniform(inputs_key, (STEPS, inputs), minval=-limit, maxval=limit)

        def step(state, u):
            after = world.step(state, u)
            return after.state, after.reward

        return jax.lax.scan(step, world.reset(reset), us)[1]

    many, found = eqx.filter_jit(jax.vmap(roll_out)), {}
    for count in ROLL_OUTS:
        keys = jax.random.split(jax.random.key(seed), count)
        rewards = jax.block_until_ready(many(keys))
        seconds = []
        for _ in range(REPEATS):
            before = time.perf_counter()
            jax.block_until_ready(many(keys))
            seconds.append(time.perf_counter() - before)
        found[str(count)] = {
            "steps_per_second_best": count * STEPS / min(seconds),
            "steps_per_second_median": count * STEPS / np.median(seconds),
            "finite_share": np.mean(np.isfinite(rewards)),
        }
        print(f"imagination, {count} at once: {count * STEPS / min(seconds):.3g} steps/s", flush=True)
    return {"steps": STEPS, "repeats": REPEATS, "limit": limit, "roll_outs": found}


def weights_hash(model):
    """Hash the weights that control uses, so that results of two models are never mixed."""
    used = eqx.tree_at(lambda m: m.velocity_prior, model, None, is_leaf=lambda x: x is None)
    leaves = jax.tree.leaves(eqx.filter(used, eqx.is_array))
    return hashlib.sha256(b"".join(np.asarray(leaf).tobytes() for leaf in leaves)).hexdigest()[:16]


def plain(value):
    """Return a value as JSON holds it, with four digits."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return float(f"{value:.4g}") if math.isfinite(value) else None
    return value


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="name of the result")
    parser.add_argument("run", help="run folder, or a trained model of the package")
    parser.add_argument("--only", nargs="+", default=EXPERIMENTS, choices=EXPERIMENTS, metavar="EXPERIMENT")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--trials", type=int, help="trials of each experiment, for a quick run")
    parser.add_argument("--workers", type=int, help="processes that simulate and render; by default one a core")
    parser.add_argument("--out", type=Path, default=Path("results/control"))
    options = parser.parse_args()

    model, config = load_run(run_folder(options.run))
    system = get(config.system)
    path, weights = options.out / f"{options.name}.json", weights_hash(model)
    kept = read_json(path, dict[str, Any]) or {}
    if kept.get("weights") not in (None, weights):
        aside = path.rename(aside_of(path, kept["weights"]))
        print(f"{path} was of other weights: moved to {aside}; all experiments run again", file=sys.stderr)
        kept = {}
    experiments = kept.get("experiments", {})
    planned = configs(config.system, options.seed)
    if options.trials is not None:
        planned = {name: dataclasses.replace(each, trials=options.trials) for name, each in planned.items()}

    for name in [each for each in EXPERIMENTS if each in options.only]:
        settings = planned[name].as_dict() if name in planned else {"seed": options.seed}
        settings = json.loads(json.dumps(settings))
        if experiments.get(name, {}).get("settings") == settings:
            print(f"{name}: done before", flush=True)
            continue
        print(f"{name}:", flush=True)
        before = time.monotonic()
        if name in planned:
            scores = closed_loop_scores(model, system, config, planned[name], options.workers)
        else:
            scores = imagination(model, system, config.epsilon, options.seed)
        machine = environment()
        experiments[name] = {
            "settings": settings,
            "scores": plain(scores),
            "commit": machine["commit"],
            "seconds": round(time.monotonic() - before, 1),
            "load": round(os.getloadavg()[0], 2),
            "cores_allowed": len(os.sched_getaffinity(0)),
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(
            path,
            {
                "command": f"python validation/control.py {options.name} {options.run} --seed {options.seed}",
                "system": config.system,
                "run": {"model": config.model, "preset": config.preset, "seed": config.seed},
                "weights": weights,
                "seed": options.seed,
                "machine": {key: machine[key] for key in ("processor", "cores", "devices", "packages", "python")},
                "experiments": {each: experiments[each] for each in EXPERIMENTS if each in experiments},
            },
        )


if __name__ == "__main__":
    main()
