"""How often training begins again: the stages vision and dynamics of the default preset, for many seeds.

python validation/every_seed.py pendulum cartpole acrobot --seeds 20     results/every-seed/SYSTEM.json

These stages are cheap, and they are the ones that can fail for want of luck. Each seed is a run folder of its own; the
same command continues after a kill, and adds seeds to the results that are there.
"""

import argparse
import dataclasses
import json
import time
from pathlib import Path

from keycld import KeycldError
from keycld.cli.making import data_for
from keycld.models import config_for
from keycld.models.keycld.recipes.fast import FastConfig
from keycld.training import environment, read_verdict, train


class _FirstStages(FastConfig):
    """The preset without its stages joint and prior."""

    def stages(self, scene):
        """Return the stages vision and dynamics."""
        return super().stages(scene)[:2]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("systems", nargs="+", help="systems, or folders of data sets")
    parser.add_argument("--seeds", type=int, default=20, help="how many, from 0 on")
    parser.add_argument("--runs", type=Path, default=Path("runs/every-seed"))
    parser.add_argument("--out", type=Path, default=Path("results/every-seed"))
    options = parser.parse_args()

    whole = config_for("keycld", "fast")
    first = _FirstStages(**{field.name: getattr(whole, field.name) for field in dataclasses.fields(whole)})
    options.out.mkdir(parents=True, exist_ok=True)
    for system in options.systems:
        data = data_for(system)
        name = Path(data).name
        path = options.out / f"{name}.json"
        done = {each["seed"]: each for each in json.loads(path.read_text())["runs"]} if path.exists() else {}
        for seed in range(options.seeds):
            if seed in done:
                continue
            run, since = options.runs / f"{name}-{seed}", time.process_time()
            try:
                train(data, run, first, seed=seed)
            except KeycldError as error:
                print(f"seed {seed}: {error}", flush=True)
            verdict = read_verdict(run)
            if verdict is None:
                continue
            cpu, commit = round(time.process_time() - since), environment()["commit"]
            done[seed] = {"seed": seed, **verdict, "cpu_seconds": cpu, "commit": commit}
            result = {
                "command": f"python validation/every_seed.py {system} --seeds {options.seeds}",
                "restarts": sum(len(each["failures"]) for each in done.values()),
                "second_restarts": sum(len(each["failures"]) > 1 for each in done.values()),
                "runs": [done[seed] for seed in sorted(done)],
            }
            path.write_text(json.dumps(result, indent=1) + "\n")
            print(
                f"{name} seed {seed}: {'passed' if verdict['passed'] else 'failed'}, {verdict['failures']}", flush=True
            )


if __name__ == "__main__":
    main()
