"""How often `keycld watch --mechanism auto` finds the mechanism: on drawn clips and on given ones.

python validation/discovery.py --seed 200 --out results/discovery.json
python validation/discovery.py --clips swing.mp4=pendulum links.mp4=double-pendulum --out FILE.json
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

from validation.drawn_clips import KINDS, Camera, drawn

from keycld.cli.alternatives import compare
from keycld.drawing import save_movie
from keycld.mechanics import load_constraints


def looked_at(clip: Path, expected: str) -> dict:
    """Return what was found in a clip next to what it shows."""
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        chosen, found = compare(clip, Path(folder), {})
    truth = load_constraints(expected)
    best = next((each for each in found if each["chosen"]), None)
    freedom = truth.dimension - truth.count
    alike = best is not None and (len(best["keypoints"]), best["freedom"]) == (len(truth.keypoints), freedom)
    result = {
        "clip": clip.stem,
        "shows": expected,
        "found": "not identifiable" if best is None else best["mechanism"] or "without a name",
        "right": alike and best is not None and best["mechanism"] == expected,
        "cpu_seconds": round(time.process_time() - began, 1),
        "alternatives": found,
    }
    print(json.dumps({name: result[name] for name in ("clip", "shows", "found", "right", "cpu_seconds")}), flush=True)
    return result


def main() -> None:
    """Look at all clips and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, help="of drawn clips; without it none are drawn")
    parser.add_argument("--clips", nargs="*", default=[], metavar="CLIP=MECHANISM")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    results = []
    if options.seed is not None:
        with tempfile.TemporaryDirectory() as folder:
            for kind, (_, expected) in KINDS.items():
                path = Path(folder) / f"{kind}-{options.seed}.mp4"
                save_movie(path, drawn(kind, options.seed).frames, fps=Camera().fps, scale=1)
                results.append(looked_at(path, expected))
    for pair in options.clips:
        path, _, expected = pair.rpartition("=")
        results.append(looked_at(Path(path), expected))
    table = {
        "seed": options.seed,
        "right": sum(each["right"] for each in results),
        "of": len(results),
        "clips": results,
    }
    if options.out is not None:
        options.out.write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    main()
