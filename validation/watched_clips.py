"""What `keycld watch` measures on drawn clips whose constants are known: errors, and whether error bars hold them.

python validation/watched_clips.py OUT [--only NAME ...] [--table FILE.json]     results/watched-clips.json

Each clip is drawn (`drawn_clips.py`, `plotted_clips.py`, `phone_clips.py`), watched through the command line with the
mechanism told and nothing else, and its physics.json compared with the truth. Clips that are done are not watched
again. Periods should be within 1 %, viscous rates within 10 %, and the intervals of one and two standard errors hold
68 and 95 % of all constants.
"""

import argparse
import json
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from validation.drawn_clips import KINDS, Camera, Drawn, drawn
from validation.phone_clips import PHONE
from validation.plotted_clips import PLOTTED

from keycld.drawing import save_movie


class Clip(NamedTuple):
    """What is drawn, and how it is recorded."""

    kind: str
    seed: int
    camera: Camera

    @property
    def name(self) -> str:
        """Kind, seed, seconds, frames a second, and the tilt and the varying exposure where there are some."""
        camera = self.camera
        tilt = f"-{camera.tilt:g}deg" if camera.tilt else ""
        exposure = f"-{camera.exposure:.0%}" if camera.exposure else ""
        return f"{self.kind}-{self.seed}-{camera.frames / camera.fps:g}s-{camera.fps:g}fps{tilt}{exposure}"


CLIPS = (
    Clip("damped_pendulum", 300, Camera()),
    Clip("damped_pendulum", 301, Camera(600, 60.0, 15.0)),
    Clip("damped_pendulum", 302, Camera(1800, 30.0)),
    Clip("damped_pendulum", 303, Camera(exposure=0.03)),
    Clip("hidden_pivot", 300, Camera()),
    Clip("hidden_pivot", 301, Camera(600, 60.0)),
    Clip("damped_double_pendulum", 300, Camera()),
    Clip("damped_double_pendulum", 301, Camera(600, 60.0, -10.0)),
    Clip("spring_cart", 300, Camera()),
    Clip("spring_cart", 301, Camera(1800, 30.0)),
    Clip("hanging_cart_pole", 300, Camera()),
    Clip("short_swing", 300, Camera()),
    Clip("plotted_discs", 300, Camera()),
    Clip("plotted_line", 300, Camera()),
    Clip("plotted_trace", 300, Camera()),
    Clip("phone_pendulum", 300, Camera()),
    Clip("phone_hand", 300, Camera()),
    Clip("phone_hand", 5, Camera()),
    Clip("phone_upright", 300, Camera()),
    Clip("phone_caught", 300, Camera()),
    Clip("phone_spring", 300, Camera()),
    Clip("phone_double", 300, Camera(480, 60.0)),
)
KEYCLD = Path(sys.executable).with_name("keycld")
LIMITS = {"period": 0.01, "viscous_rate": 0.1}
"""Largest errors, as a share of the truth, by the beginning of a constant's name."""


def watched(clip: Clip, out: Path) -> dict[str, Any]:
    """Return what `keycld watch` found in a clip, next to the truth."""
    found, mechanism = _made(clip)
    run, video = out / clip.name, out / f"{clip.name}.mp4"
    physics, spent = run / "evaluation" / "physics.json", out / f"{clip.name}.json"
    if not spent.exists():
        save_movie(video, found.frames, fps=clip.camera.fps, scale=1)
        command = ["watch", str(video), "--mechanism", mechanism, "--out", str(run)]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        with (out / f"{clip.name}.log").open("w") as log:
            ended = subprocess.run([KEYCLD, *command], stdout=log, stderr=subprocess.STDOUT)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        spent.write_text(json.dumps({"code": ended.returncode, "cpu_seconds": round(seconds)}))
    result: dict[str, Any] = {"clip": clip.name, **json.loads(spent.read_text())}
    if result["code"]:
        failure = (out / f"{clip.name}.log").read_text().replace("\r", "\n").strip().splitlines()[-1]
        return result | {"failure": failure}
    measured = json.loads(physics.read_text())
    return result | {
        "forces": measured["forces"],
        "prediction": measured["prediction"]["error"],
        "constants": {name: compared(name, truth, measured["constants"]) for name, truth in found.truth.items()},
    }


def _made(clip: Clip) -> tuple[Drawn, str]:
    """Return a clip with its truth, and the mechanism that it shows."""
    others = PLOTTED | PHONE
    if clip.kind in others:
        make, mechanism = others[clip.kind]
        return make(np.random.default_rng(clip.seed), clip.camera), mechanism
    return drawn(clip.kind, clip.seed, clip.camera), KINDS[clip.kind][1]


def compared(name: str, truth: float, constants: dict[str, Any]) -> dict[str, Any]:
    """Return a constant next to its truth: its error, and the error in standard errors."""
    measured = constants.get(name, {"value": None, "sigma": None})
    value, sigma = measured["value"], measured["sigma"]
    result = {"truth": round(truth, 5), "value": value, "sigma": sigma}
    if value is not None:
        # Directions have no scale of their own: radians.
        result["error"] = round(np.radians(value - truth) if name == "gravity_direction" else value / truth - 1, 5)
        result["in_sigmas"] = round((value - truth) / sigma, 2) if sigma else None
    limit = next((most for start, most in LIMITS.items() if name.startswith(start)), None)
    if limit is not None:
        result["passes"] = value is not None and abs(result["error"]) < limit
    return result


def summary(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Return how many clips, constants and intervals are right. Damping ratios follow from the others."""
    named = [each for result in results for each in result.get("constants", {}).items()]
    constants = [each for name, each in named if not name.startswith("damping_ratio")]
    sigmas = np.abs([each["in_sigmas"] for each in constants if each.get("in_sigmas") is not None])
    judged = [each["passes"] for each in constants if "passes" in each]
    return {
        "clips": len(results),
        "failed": sum("failure" in each for each in results),
        "within_limits": sum(judged),
        "of": len(judged),
        "intervals": len(sigmas),
        "covers_68": round(float(np.mean(sigmas < 1.0)), 3) if len(sigmas) else None,
        "covers_95": round(float(np.mean(sigmas < 1.96)), 3) if len(sigmas) else None,
    }


def main() -> None:
    """Watch the clips one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="*", choices=[clip.name for clip in CLIPS])
    parser.add_argument("--table", type=Path)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    results = []
    for clip in CLIPS:
        if options.only and clip.name not in options.only:
            continue
        results.append(watched(clip, options.out))
        print(json.dumps(results[-1]), flush=True)
    table = {
        "command": "python validation/watched_clips.py OUT",
        "limits": LIMITS,
        **summary(results),
        "clips": results,
    }
    print(json.dumps(summary(results)))
    if options.table is not None:
        options.table.write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    main()
