"""Memory over 100,000 training steps and 1,000 predictions, each in one process.

`python -m validation.faults.memory --work FOLDER` after `fuzz`, which makes the whole files in FOLDER. Prints the
largest resident size after the first tenth, as a share of that at the tenth.
"""

import argparse
import json
import os
import shutil
import threading
import time
from pathlib import Path
from typing import Any

from validation.faults.originals import AR


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
    """Train a recurrent model with cheap steps, with a checkpoint and a line of the log every 500 of them."""
    from keycld.models import config_for
    from keycld.training import train

    sizes: list[int] = []
    out, done = base / "long", threading.Event()
    shutil.rmtree(out, ignore_errors=True)

    def watch() -> None:
        lines = 0
        while not done.wait(0.05):
            path = out / "metrics.jsonl"
            found = path.read_text().count("\n") if path.exists() else 0
            if found > lines:
                lines = found
                sizes.append(resident())

    watcher = threading.Thread(target=watch)
    watcher.start()
    since = time.monotonic()
    try:
        config = config_for("ar", "fast", **{**AR, "steps": steps})
        train(base / "original/data", out, config, log_every=500, checkpoint_seconds=0.0)
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
