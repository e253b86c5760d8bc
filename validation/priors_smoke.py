"""Every model of "Which priors matter?" on every one of its 17 data sets: 20 steps of tiny networks, one evaluation.

`python validation/priors_smoke.py [--out FOLDER] [--sets toy/pendulum,…] [--models hgn,…]`. Pictures are stored, so
that all sets have arrays of the same shape, and each model compiles once. Ends with code 1 if anything fails.
"""

import argparse
import dataclasses
import sys
import tempfile
import time
import traceback
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from keycld.benchmarks import suite_named
from keycld.benchmarks.published_priors import PRIORS_TITLES
from keycld.data import make_data, open_data
from keycld.evaluation import evaluate, protocol_named, references
from keycld.models import config_for
from keycld.systems import AbstractSampledSystem, get
from keycld.training.runs import make_scene
from keycld.training.step import initial_progress, make_step

TINY = {"steps": 20, "batch": 2, "channels": 4, "hidden": 8, "latent": 4}
FRAMES, TRAJECTORIES = 100, 16


def made(system: str, root: Path):
    """Return a small data set with stored pictures; molecules come in simulations of 70 trajectories."""
    folder = root / system
    # A file has at least 71 molecules' trajectories; the others are as few as the rest needs.
    few = {"train": 142, "test": 70} if system.startswith("md/") else {"train": 20, "test": 2}
    sampled = get(system)
    assert isinstance(sampled, AbstractSampledSystem)
    known = sampled.counts["default"]
    runs = {**few, **({"test_long": 2} if "test_long" in known else {})}
    make_data(system, folder, store="images", runs=runs, frames=dict.fromkeys(runs, FRAMES))
    return open_data(folder)


def first(resident):
    """Return the first trajectories of a resident set: as many of each set."""
    count = resident.image.shape[0]
    return jax.tree.map(lambda leaf: leaf[:TRAJECTORIES] if leaf.shape[:1] == (count,) else leaf, resident)


def trained(model: str, steps: dict, dataset, resident):
    """Return a model after 20 steps in all."""
    config = config_for(model, "fast", **TINY)
    scene = dataclasses.replace(make_scene(resident.image.shape, dataset), trajectories=TRAJECTORIES)
    built = config.build(scene, jax.random.key(0))
    for number, stage in enumerate(config.stages(scene)):
        run = steps.setdefault((model, number), make_step(stage, number, 0, stage.steps))
        progress, rest = initial_progress(stage, built)
        progress, terms = run((rest, resident), progress)
        built = eqx.combine(progress.parameters, rest)
        assert bool(progress.healthy) and np.isfinite(terms["loss"]).all(), f"{stage.name} is not finite"
    return built


def main() -> int:
    """Run all of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="where the data sets are made; a temporary folder by default")
    parser.add_argument("--sets", default="", help="such as toy/pendulum,md/lj_4; all by default")
    parser.add_argument("--models", default="", help="such as hgn,ar; all by default")
    chosen = parser.parse_args()
    suite, since = suite_named("priors"), time.monotonic()
    sets = [name for name in chosen.sets.split(",") if name] or [data.system for data in suite.data]
    models = [name for name in chosen.models.split(",") if name] or list(PRIORS_TITLES)
    protocol = dataclasses.replace(protocol_named(f"test@{FRAMES}-priors-of-2"), shown=1)
    failed, steps = [], {}
    with tempfile.TemporaryDirectory() as temporary:
        for system in sets:
            dataset = made(system, chosen.out or Path(temporary))
            resident = first(dataset.resident("train"))
            shared = references(dataset)
            for model in models:
                try:
                    scores = evaluate(trained(model, steps, dataset, resident), dataset, protocol, shared=shared).scores
                    outcome = f"error {scores['table_units']['extrapolation']:.0f}"
                except Exception as error:
                    traceback.print_exc()
                    failed.append(f"{model} on {system}: {type(error).__name__}: {error}")
                    outcome = failed[-1]
                print(f"{time.monotonic() - since:6.0f} s  {system:34} {model:8} {outcome}", flush=True)
    pairs = len(sets) * len(models)
    cost = f"{time.monotonic() - since:.0f} s, {time.process_time():.0f} s of CPU"
    print(f"{pairs - len(failed)} of {pairs} pairs in {cost}")
    print("\n".join(failed))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
