"""Kills at every event that changes files, and a disk that fills up at every size, for every verb that writes.

`python -m validation.faults.kill --work FOLDER` after `fuzz`, which makes the whole files in FOLDER. Before each event
that changes files, of the verb or a Python process that it starts, the folder is copied as it is: what signal 9 would
leave there. From each copy the same command must give the files of a run that was not killed. `--limit` lets every
file end at some sizes instead, as on a full disk, and `--disk` gives a disk in memory that is read-only or has little
room left (for an administrator only). Both must be told in one sentence, and leave no half files.
"""

import argparse
import hashlib
import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from validation.faults.fuzz import REPOSITORY, Worker, prepare, run_verb

HOOK = Path(__file__).parent / "hook"

# What the recordings of time and machine make different in every run.
_TIMED = ("statistics.json", "environment.json", "metrics.jsonl", "README.md", "config.json", "position.json")
VERBS: dict[str, tuple[str, ...]] = {
    "import of a video": ("data", "import", "{work}/swing.mp4", "--out", "{work}/new", "--size", "8", "--frames", "5"),
    "import of a suite": ("data", "import", "{work}/matching_pennies", "--out", "{work}/new"),
    "data show": ("data", "show", "{work}/data", "--out", "{work}/new/out.gif", "--scale", "1"),
    "report": ("report", "{work}/run"),
    "bench table": ("bench", "table", "keycld", "--root", "{work}/bench", "--results", "{work}/results", "--systems",
                    "pendulum", "--models", "keycld", "--seeds", "0", "--out", "{work}/new"),
    "predict": ("predict", "{work}/run", "--data", "{work}/data/test.h5", "--out", "{work}/new/out.h5"),
    "eval": ("eval", "{work}/run", "--data", "{work}/data", "--protocols", "test@10"),
    "train": ("train", "{work}/data", "--config", "{work}/run/config.json", "--out", "{work}/new"),
    "data make": ("data", "make", "pendulum", "--out", "{work}/new", "--train", "4", "--validation", "2", "--test", "2",
                  "--long", "1", "--size", "16", "--workers", "1"),
}  # fmt: skip


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
    """Copy the folder at each event of a verb, and compare what a call of it makes of each copy."""
    outer, copies = fresh(base), base / "copies"
    work = outer / "work"
    words = [word.replace("{work}", str(work)) for word in VERBS[name]]
    before = contents(work)
    shutil.rmtree(copies, ignore_errors=True)
    copies.mkdir()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(HOOK), str(REPOSITORY), *sys.path]),
                                "FAULTS_WORK": str(work), "FAULTS_COPIES": str(copies)}  # fmt: skip
    command = [sys.executable, "-m", "keycld.cli.main", *words]
    subprocess.run(command, cwd=outer, env=environment, check=True, capture_output=True)
    expected, lost, half, other = contents(work), 0, 0, 0
    moments = sorted(copies.iterdir())
    worker = Worker(base)
    for moment in moments:
        shutil.rmtree(work)
        moment.rename(work)
        left = contents(work)
        lost += sum(path not in left for path in before)
        half += sum(digest not in (before.get(path), expected.get(path)) for path, digest in left.items())
        worker = worker if worker.alive else Worker(base)
        again = worker.run(words, outer, limit)
        orphans = [path for path in outer.rglob(".*partial") if path.name != ".partial"]
        found = contents(work)
        different = sorted(path for path in {**found, **expected} if found.get(path) != expected.get(path))
        done = again["exit"] == 0 or "already holds data" in again["said"]
        if not done or different or orphans or again["faults"]:
            other += 1
            print(name, moment.name, again, different, orphans, file=sys.stderr, flush=True)
    if worker.alive:
        worker.end()
    return {"kills": len(moments), "lost": lost, "half": half, "different_after_resuming": other}


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


def disks(base: Path, name: str, limit: float) -> dict[str, Any]:
    """Run a verb on disks that are read-only or have some KiB left, and look at what it says and leaves."""
    outer = base / "disk"
    outer.mkdir(exist_ok=True)
    words = [word.replace("{work}", str(outer / "work")) for word in VERBS[name]]
    found: dict[str, Any] = {"tries": 0, "refused": 0, "faults": 0, "half": 0, "left_over": 0}
    worker, expected = Worker(base), {}
    for room in ("plenty", "none at all", 0, 4, 16, 64, 256, 1024):
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=200m", "faults", outer], check=True)
        try:
            shutil.copytree(base / "original", outer / "work")
            before, disk = contents(outer / "work"), os.statvfs(outer)
            used = (disk.f_blocks - disk.f_bfree) * disk.f_frsize // 1024
            option = {"plenty": "size=200m", "none at all": "ro"}.get(str(room)) or f"size={used + int(room)}k"
            subprocess.run(["mount", "-o", f"remount,{option}", outer], check=True)
            worker = worker if worker.alive else Worker(base)
            ended = worker.run(words, outer, limit)
            left = contents(outer / "work")
            expected = expected or left
            orphans = [path for path in outer.rglob(".*partial") if path.name != ".partial"]
        finally:
            worker.leave()
            # A file of a verb that has failed may wait for the garbage collector.
            subprocess.run(["umount", "--lazy", outer], check=True)
        half = [path for path, digest in left.items() if digest not in (before.get(path), expected.get(path))]
        found["tries"] += 1
        found["refused"] += ended["exit"] == 2
        found["faults"] += bool(ended["faults"] or ended["unforeseen"])
        found["half"] += len(half) + len(before.keys() - left.keys())
        found["left_over"] += len(orphans)
        if ended["faults"] or ended["unforeseen"] or half or orphans:
            print(name, room, ended, half, orphans, file=sys.stderr, flush=True)
    if worker.alive:
        worker.end()
    return found


def main() -> None:
    """Print what every verb did."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--verbs", nargs="*", default=list(VERBS))
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--limit", action="store_const", dest="way", const=full)
    way.add_argument("--disk", action="store_const", dest="way", const=disks, default=kills)
    options = parser.parse_args()
    base = options.work.resolve()
    prepare(base)
    for name in options.verbs:
        found = options.way(base, name, 120.0)
        print(json.dumps({name: found}), flush=True)


if __name__ == "__main__":
    main()
