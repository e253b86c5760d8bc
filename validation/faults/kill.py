"""Kills at every event that changes files, and a disk that fills up at every size, for every verb that writes.

`python -m validation.faults.kill --work FOLDER` after `fuzz`, which makes the whole files in FOLDER. A verb dies with
signal 9 before its n-th such event, for each n; then the same command must give the files of a run that was not
killed. `--limit` lets every file end at some sizes instead, as on a full disk, which must be told in one sentence.
"""

import argparse
import hashlib
import json
import os
import resource
import shutil
import sys
from pathlib import Path
from typing import Any

from validation.faults.fuzz import prepare, run_verb

# What the recordings of time and machine make different in every run.
_TIMED = ("statistics.json", "environment.json", "metrics.jsonl", "README.md")
_CHANGES = (
    "os.mkdir",
    "os.rename",
    "os.remove",
    "os.rmdir",
    "shutil.rmtree",
    "os.truncate",
    "os.link",
    "shutil.copyfile",
)
VERBS: dict[str, tuple[str, ...]] = {
    "import of a video": ("data", "import", "{work}/swing.mp4", "--out", "{work}/new", "--size", "8", "--frames", "5"),
    "import of a suite": ("data", "import", "{work}/matching_pennies", "--out", "{work}/new"),
    "data show": ("data", "show", "{work}/data", "--out", "{work}/new/out.gif", "--scale", "1"),
    "report": ("report", "{work}/run"),
    "bench table": ("bench", "table", "keycld", "--root", "{work}/bench", "--results", "{work}/results", "--systems",
                    "pendulum", "--models", "keycld", "--seeds", "0", "--out", "{work}/new"),
    "predict": ("predict", "{work}/run", "--data", "{work}/data/test.h5", "--out", "{work}/new/out.h5"),
}  # fmt: skip


def die_at(moment: int) -> None:
    """End this process with signal 9 before its n-th event that changes files."""
    left = moment

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal left
        writes = event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)
        if event in _CHANGES or (writes and "/dev/" not in str(arguments[0])):
            left -= 1
            if left == 0:
                os.kill(os.getpid(), 9)

    sys.addaudithook(hook)


def contents(folder: Path) -> dict[str, str]:
    """Return the hashes of all visible files whose contents do not depend on the time."""
    found = {}
    for path in sorted(folder.rglob("*")):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if path.is_file() and not hidden and path.name not in _TIMED:
            found[str(path.relative_to(folder))] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def fresh(base: Path) -> Path:
    """Return a new folder with the whole files."""
    outer = base / "case" / "a"
    shutil.rmtree(base / "case", ignore_errors=True)
    outer.mkdir(parents=True)
    shutil.copytree(base / "original", outer / "work")
    return outer


def kills(base: Path, name: str, limit: float) -> dict[str, Any]:
    """Kill a verb at each of its events, and compare what the next call of it leaves."""
    outer = fresh(base)
    words = [word.replace("{work}", str(outer / "work")) for word in VERBS[name]]
    before = contents(outer / "work")
    whole = run_verb(words, outer, limit)
    expected, lost, half, other, moment = contents(outer / "work"), 0, 0, 0, 0
    assert whole["exit"] == 0, whole
    while True:
        moment += 1
        outer = fresh(base)
        killed = run_verb(words, outer, limit, lambda n=moment: die_at(n))
        left = contents(outer / "work")
        lost += sum(path not in left for path in before)
        half += sum(digest not in (before.get(path), expected.get(path)) for path, digest in left.items())
        again = run_verb(words, outer, limit)
        orphans = [path for path in outer.rglob(".*partial") if path.name != ".partial"]
        done = again["exit"] == 0 or "already holds data" in again["said"]
        other += not done or contents(outer / "work") != expected or bool(orphans)
        if killed["exit"] == 0:
            return {"kills": moment - 1, "lost": lost, "half": half, "different_after_resuming": other}


def full(base: Path, name: str, limit: float) -> dict[str, Any]:
    """Let every file of a verb end at some sizes, and look at what it says and leaves."""
    outer = fresh(base)
    words = [word.replace("{work}", str(outer / "work")) for word in VERBS[name]]
    before = contents(outer / "work")
    found = {"tries": 0, "faults": 0, "half": 0}
    run_verb(words, outer, limit)
    expected = contents(outer / "work")
    for size in (0, 1, 100, 1000, 3000, 10_000, 30_000, 100_000):
        outer = fresh(base)
        ended = run_verb(words, outer, limit, lambda n=size: resource.setrlimit(resource.RLIMIT_FSIZE, (n, n)))
        left = contents(outer / "work")
        found["tries"] += 1
        if ended["faults"] or ended["unforeseen"]:
            found["faults"] += 1
            print(name, size, ended, file=sys.stderr, flush=True)
        found["half"] += sum(digest not in (before.get(path), expected.get(path)) for path, digest in left.items())
    return found


def main() -> None:
    """Print what every verb did."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--verbs", nargs="*", default=list(VERBS))
    parser.add_argument("--limit", action="store_true")
    options = parser.parse_args()
    base = options.work.resolve()
    prepare(base)
    for name in options.verbs:
        found = (full if options.limit else kills)(base, name, 120.0)
        print(json.dumps({name: found}), flush=True)


if __name__ == "__main__":
    main()
