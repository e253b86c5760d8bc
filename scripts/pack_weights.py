"""Puts trained and evaluated runs into the package: python scripts/pack_weights.py RUN [RUN ...]."""

import json
import sys
from pathlib import Path

from keycld.data import open_data
from keycld.training import pack

CARD = """# KeyCLD, {system}

Keypoints, masses, potential energy and input matrix of the {system}, learned from pictures alone.

| | |
|---|---|
| data | `keycld data make {system}`: 450 recordings of 50 frames, 64×64, MuJoCo, llvmpipe; protocol {protocol} |
| command | `keycld train {system} --preset {preset} --seed {seed}` |
| seed | {seed}; `docs/results.md` has others |
| commit | {commit} |
| training | {seconds:.0f} s wall-clock, {cpu:.0f} CPU seconds, {frames} frames; {processor}, {cores} cores |
| precision | networks and pictures float16, mechanics float32 |

Valid prediction time as a part of the frames, from two given frames, float32 weights; mean over {n} recordings that
nothing was chosen on:

| protocol | VPT | best trivial predictor |
|---|---|---|
{rows}

**Use.** `keycld predict {system} --data FILE.h5 --out OUT.h5`, `keycld report {system}`, or in Python
`keycld.load("{system}")`.

**Limits.** A motion is taken to have just begun, as in the data, where what is seen allows it. It knows this camera,
light and background, and motions like those of the data: {limit}
Masses, energies and inputs are known up to one common factor, potential energy up to a constant. Far beyond the
scored horizon a prediction keeps its energy but not its phase.
"""
LIMITS = {
    "pendulum": "up to about 28 rad/s, |u| ≤ 3.",
    "cartpole": "half a second from hanging at rest near the middle, |u| ≤ 3.",
    "acrobot": "half a second from rest anywhere, |u| ≤ 3.",
}


def card(run: Path) -> str:
    """Return the model's card from what the run has stored."""
    config = json.loads((run / "config.json").read_text())
    environment = json.loads((run / "environment.json").read_text())
    last = json.loads((run / "metrics.jsonl").read_text().splitlines()[-1])
    scores = {path.stem: json.loads(path.read_text()) for path in sorted((run / "evaluation").glob("test*.json"))}
    rows = [
        f"| `{name}` | {score['vpt']['1']['mean']:.3f} (σ {score['vpt']['1']['std']:.2f}) | "
        f"{max(each['vpt']['1']['mean'] for each in score['baselines'].values()):.3f} |"
        for name, score in scores.items()
    ]
    return CARD.format(
        system=config["system"],
        protocol=open_data(config["data"]).attributes["protocol"],
        preset=config["preset"],
        seed=config["seed"],
        commit=environment["commit"],
        seconds=last["seconds"],
        cpu=last["cpu_seconds"],
        frames=last["frames"],
        processor=environment["processor"],
        cores=environment["cores"],
        n=next(iter(scores.values()))["n"],
        rows="\n".join(rows),
        limit=LIMITS[config["system"]],
    )


if __name__ == "__main__":
    for name in sys.argv[1:]:
        folder = pack(name, card(Path(name)))
        print(folder, f"{sum(path.stat().st_size for path in folder.iterdir()) / 1e6:.2f} MB")
