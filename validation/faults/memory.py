"""Memory over 100,000 training steps and 1,000 predictions, each in one process.

`python -m validation.faults.memory --work FOLDER` after `fuzz`, which makes the whole files in FOLDER. Prints the
largest resident size after the first tenth, as a share of that at the tenth.
"""

import argparse
import json
import os
import shutil
import sys
import threading
import time
from pathlib import Path
from typing import Any

from validation.faults.fuzz import REPOSITORY


def resident() -> int:
    """Return the bytes of memory that this process has."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def flatness(sizes: list[int]) -> dict[str, Any]:
    """Compare the sizes after the first tenth with the one there."""
    tenth = sizes[len(sizes) // 10]
    largest = max(sizes[len(sizes) // 10 :])
    return {"samples": len(sizes), "bytes_at_a_tenth": tenth, "largest_bytes_after": largest,
            "last_bytes": sizes[-1], "growth": round(largest / tenth - 1, 4)}  # fmt: skip


def training(base: Path, steps: int) -> dict[str, Any]:
    """Train with cheap steps, and look at the size every 500 of them."""
    sys.path.insert(0, str(REPOSITORY / "tests"))
    from keycld.models import config_for
    from keycld.training import train
    from scenes import TINY  # pyright: ignore[reportMissingImports]

    vision = {**TINY["vision"], "steps": steps, "candidates": 1}
    sizes: list[int] = []
    out, done = base / "long", threading.Event()
    shutil.rmtree(out, ignore_errors=True)

    def watch() -> None:
        lines = 0
        while not done.wait(0.2):
            path = out / "metrics.jsonl"
            text = path.read_text() if path.exists() else ""
            if text.count("\n") > lines and '"vision"' in text.splitlines()[-1]:
                lines = text.count("\n")
                sizes.append(resident())

    watcher = threading.Thread(target=watch)
    watcher.start()
    since = time.monotonic()
    try:
        train(base / "original/data", out, config_for("keycld", "fast", **{**TINY, "vision": vision}), log_every=500)
    finally:
        done.set()
        watcher.join()
    return {"steps": steps, "seconds": round(time.monotonic() - since), **flatness(sizes)}


def predictions(base: Path, count: int) -> dict[str, Any]:
    """Predict the same file many times."""
    from keycld.evaluation import predict_file
    from keycld.training import load_model

    sizes = []
    since = time.monotonic()
    for _ in range(count):
        model, _ = load_model(str(base / "original/run"))
        predict_file(model, base / "original/data/test.h5", base / "out.h5")
        sizes.append(resident())
    return {"predictions": count, "seconds": round(time.monotonic() - since), **flatness(sizes)}


def main() -> None:
    """Print both."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--predictions", type=int, default=1000)
    options = parser.parse_args()
    base = options.work.resolve()
    if options.predictions:
        print(json.dumps({"predictions": predictions(base, options.predictions)}), flush=True)
    if options.steps:
        print(json.dumps({"training": training(base, options.steps)}), flush=True)


if __name__ == "__main__":
    main()
