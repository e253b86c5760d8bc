"""Kills at every event that changes files, and a disk that fills up at every size, for every verb that writes.

`python -m validation.faults.kill --work FOLDER` after `fuzz`, which makes the whole files in FOLDER. Before each event
that changes files, of the verb or a Python process that it starts, the folder is copied as it is: what signal 9 would
leave there. From each copy the same command must give the files of a run that was not killed, as far as two such runs
give the same. Copies that no later process can tell apart are one state. `--limit` lets every file end at some sizes
instead, as on a full disk; `--disk` gives a disk in memory that is read-only or has little room left, and `--quota` one
with room on which the folder may hold little more (both for an administrator only). Each must be told in one sentence,
and leave no half files.
"""

import argparse
import hashlib
import json
import os
import re
import runpy
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
from safetensors.numpy import load_file
from validation.faults.fuzz import REPOSITORY, Worker, exit_code, prepare
from validation.faults.originals import DEMO, WATCH

HOOK = Path(__file__).parent / "hook"

# What the recordings of time and machine make different in every run.
_TIMED = ("statistics.json", "environment.json", "metrics.jsonl", "README.md", "config.json", "position.json",
          "bench.json", "bench.log", "bench.lock", "table.md", "pendulum-ar-0.json",
          "pendulum-ar-0.failed.json")  # fmt: skip
# A closed loop runs in real time: a step that misses its period holds the last input.
_REAL_TIME = "control-upright"
# What names the newest of several whole things.
_POINTER = "latest"
_BENCH = ("keycld", "--root", "{work}/bench", "--results", "{work}/results", "--systems", "pendulum", "--models",
          "keycld", "--seeds", "0", "--out", "{work}/new")  # fmt: skip
_COUNTS = ("--train", "4", "--validation", "2", "--test", "2", "--long", "1")
_TEST = ("--data", "{work}/data", "--split", "test")
VERBS: dict[str, tuple[str, ...]] = {
    "import of a video": ("data", "import", "{work}/swing.mp4", "--out", "{work}/new", "--size", "8", "--frames", "5"),
    "import of a suite": ("data", "import", "{work}/matching_pennies", "--out", "{work}/new"),
    "data show": ("data", "show", "{work}/data", "--out", "{work}/new/out.gif", "--scale", "1"),
    "data make of a toy": ("data", "make", "toy/pendulum", "--train", "6", "--test", "2", "--long", "2", "--out",
                           "{work}/new", "--workers", "1"),
    "data make of MuJoCo": ("data", "make", "pendulum", "--out", "{work}/new", *_COUNTS, "--workers", "1"),
    "train": ("train", "{work}/data", "--config", "{work}/half/config.json", "--out", "{work}/new", "--log-every", "2",
              "--checkpoint-seconds", "0"),
    "train of KeyCLD": ("train", "{work}/data", "--config", "{work}/run/config.json", "--out", "{work}/new",
                        "--log-every", "2", "--checkpoint-seconds", "0"),
    "eval": ("eval", "{work}/run", "--data", "{work}/data", "--protocols", "test@10"),
    "predict": ("predict", "{work}/run", "--data", "{work}/data/test.h5", "--out", "{work}/new/out.h5"),
    "control": ("control", "{work}/packaged", "--seconds", "0.1", "--workers", "1", "--out", "{work}/run"),
    "identify": ("identify", "{work}/log.csv", "--mechanism", "pendulum", "--out", "{work}/run"),
    "export to mjcf": ("export", "{work}/run", "--to", "mjcf"),
    "export to csv": ("export", "{work}/run", "--to", "csv", *_TEST),
    "export to mujoco-sysid": ("export", "{work}/run", "--to", "mujoco-sysid", *_TEST),
    "export to lerobot": ("export", "{work}/run", "--to", "lerobot", *_TEST),
    "watch": ("watch", "{work}/clip.mp4", "--mechanism", "pendulum", "--size", "16", "--out", "{work}/new", "--set",
              *WATCH),
    "demo": ("demo", "{work}/mujoco", "--out", "{work}/begun", "--set", *DEMO),
    "report": ("report", "{work}/run"),
    "bench run": ("child", "{work}/bench", "{work}/results"),
    "bench table": ("bench", "table", *_BENCH),
    "bench figures": ("bench", "figures", *_BENCH),
    "bench report": ("bench", "report", *_BENCH),
}  # fmt: skip


def contents(folder: Path) -> dict[str, str]:
    """Return the hashes of all visible files whose contents do not depend on the time."""
    found = {}
    for path in sorted(folder.rglob("*")):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if path.is_file() and not hidden and path.name not in _TIMED and not path.name.startswith(_REAL_TIME):
            found[str(path.relative_to(folder))] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def everything(folder: Path) -> str:
    """Return the hash of all that a later process can tell apart.

    It removes the hidden folder of a dead process without looking at its number or contents.
    """
    found = set()
    for path in folder.rglob("*"):
        name, hidden = re.subn(r"\.\d+@[^/]*\.partial(/.*)?", ".partial", str(path.relative_to(folder)))
        found.add((name, path.read_bytes() if path.is_file() and not hidden else b""))
    return hashlib.sha256(repr(sorted(found)).encode()).hexdigest()


def fresh(base: Path) -> Path:
    """Return a new folder with the whole files."""
    outer = base / "case" / "a"
    shutil.rmtree(base / "case", ignore_errors=True)
    outer.mkdir(parents=True)
    shutil.copytree(base / "original", outer / "work")
    return outer


def kills(base: Path, name: str, limit: float, most: int) -> dict[str, Any]:
    """Copy the folder at each event of a verb, and compare what a call of it makes of each state, or of some."""
    outer, copies = fresh(base), base / "copies"
    work = outer / "work"
    words = [word.replace("{work}", str(work)) for word in VERBS[name]]
    before = contents(work)
    shutil.rmtree(copies, ignore_errors=True)
    copies.mkdir()
    _recorded(words, outer, copies)
    expected, moments = contents(work), sorted(copies.iterdir())
    states: dict[str, Path] = {}
    for moment in moments:
        states.setdefault(everything(moment), moment)
    chosen = list(states.values())
    if most < len(chosen):
        chosen = [chosen[k * (len(chosen) - 1) // (most - 1)] for k in range(most)]
    fresh(base)
    worker = Worker(base)
    worker.run(words, outer, limit)
    whole = contents(work)
    varies = {path for path in {**whole, **expected} if whole.get(path) != expected.get(path)}
    # A training removes its older checkpoints.
    kept = before.keys() & expected.keys()
    remains = [(moment, contents(moment)) for moment in states.values()]
    found: dict[str, Any] = {
        "kills": len(moments), "states": len(states), "continued": len(chosen),
        "absent": sum(any(path not in left for path in kept) for _, left in remains), "lost": 0,
        "half": sum(len(_half(moment, left, before, expected)) for moment, left in remains),
        "different_after_resuming": 0, "varies": sorted(varies),
    }  # fmt: skip
    for moment in chosen:
        shutil.rmtree(work)
        moment.rename(work)
        worker = worker if worker.alive else Worker(base)
        again = worker.run(words, outer, limit)
        orphans = [path for path in outer.rglob(".*partial") if path.name != ".partial"]
        after = contents(work)
        found["lost"] += any(path not in after for path in kept)
        different = [path for path in {**after, **expected} if after.get(path) != expected.get(path)]
        different = [path for path in different if path not in varies or path not in after]
        done = again["exit"] == 0 or "already holds data" in again["said"]
        if not done or different or orphans or again["faults"]:
            found["different_after_resuming"] += 1
            print(name, moment.name, again, different, orphans, file=sys.stderr, flush=True)
    if worker.alive:
        worker.end()
    return found


def _recorded(words: list[str], outer: Path, copies: Path) -> None:
    """Run a verb in a forked process that copies the folder, and so does each Python that it starts."""
    child = os.fork()
    if child == 0:
        # Processes get the path from the environment, or from their parent's `sys.path`.
        sys.path[:0] = [str(HOOK), str(REPOSITORY)]
        os.environ |= {"PYTHONPATH": os.pathsep.join(sys.path), "FAULTS_WORK": str(outer / "work"),
                       "FAULTS_COPIES": str(copies)}  # fmt: skip
        runpy.run_path(str(HOOK / "sitecustomize.py"))
        os.chdir(outer)
        nothing = os.open(os.devnull, os.O_RDWR)
        for place in range(3):
            os.dup2(nothing, place)
        os._exit(exit_code(words))
    _, status = os.waitpid(child, 0)
    if status:
        raise SystemExit(f"{' '.join(words)} ends with {os.waitstatus_to_exitcode(status)} on whole files.")


def _half(folder: Path, left: dict[str, str], *whole: dict[str, str]) -> list[str]:
    """Return the files that are as none of those that are whole, and cannot be read to their end either.

    What a training writes at some seconds, or a page with the time of day, differs between two whole runs.
    """
    known = {(path, digest) for each in whole for path, digest in each.items()}
    new = [path for path, digest in left.items() if (path, digest) not in known and Path(path).name != _POINTER]
    return [path for path in new if not _reads_to_its_end(folder / path)]


def _reads_to_its_end(path: Path) -> bool:
    """Return whether a file of a format that tells its end is whole; False for other formats."""
    try:
        match path.suffix:
            case ".json":
                json.loads(path.read_text())
            case ".safetensors":
                load_file(path)
            case ".npz":
                with np.load(path) as arrays:
                    _ = [arrays[name] for name in arrays]
            case ".png" | ".gif":
                iio.imread(path)
            case ".html":
                return path.read_text().rstrip().endswith("</html>")
            case _:
                return False
    except Exception:  # any error says the same
        return False
    return True


def full(base: Path, name: str, limit: float) -> dict[str, Any]:
    """Let every file of a verb end at some sizes, and look at what it says and leaves."""
    outer = fresh(base)
    words = [word.replace("{work}", str(outer / "work")) for word in VERBS[name]]
    before, worker = contents(outer / "work"), Worker(base)
    worker.run(words, outer, limit)
    expected = contents(outer / "work")
    found: dict[str, Any] = {"tries": 0, "refused": 0, "faults": 0, "half": 0, "left_over": 0}
    for size in (0, 1, 100, 1000, 3000, 10_000, 30_000, 100_000):
        outer = fresh(base)
        worker = worker if worker.alive else Worker(base)
        ended = worker.run(words, outer, limit, size)
        _count(found, name, size, ended, outer, before, expected)
    if worker.alive:
        worker.end()
    return found


def _count(
    found: dict[str, Any],
    name: str,
    room: object,
    ended: dict[str, Any],
    outer: Path,
    before: dict[str, str],
    expected: dict[str, str],
) -> None:
    """Add one try on a full disk to the counts; earlier files are lost where one of them is not there."""
    left = contents(outer / "work")
    orphans = [path for path in outer.rglob(".*partial") if path.name != ".partial"]
    half = [*_half(outer / "work", left, before, expected), *(before.keys() - left.keys())]
    found["tries"] += 1
    found["refused"] += ended["exit"] == 2
    found["faults"] += bool(ended["faults"] or ended["unforeseen"])
    found["half"] += len(half)
    found["left_over"] += len(orphans)
    if ended["faults"] or ended["unforeseen"] or half or orphans:
        print(name, room, ended, half, orphans, file=sys.stderr, flush=True)


def disks(base: Path, name: str, limit: float, quota: bool = False) -> dict[str, Any]:
    """Run a verb on disks that are read-only or have some KiB left, and look at what it says and leaves.

    With `quota` the disks have room, but the folder may hold some KiB more only.
    """
    outer = base / "disk"
    outer.mkdir(exist_ok=True)
    words = [word.replace("{work}", str(outer / "work")) for word in VERBS[name]]
    found: dict[str, Any] = {"tries": 0, "refused": 0, "faults": 0, "half": 0, "left_over": 0}
    worker, expected = Worker(base), {}
    # A new file of btrfs takes more than a hundred KiB at first.
    rooms = (0, 128, 192, 256, 512, 1024, 2048) if quota else ("none at all", 0, 4, 16, 64, 256, 1024)
    for room in ("plenty", *rooms):
        (_mount_with_quota if quota else _mount)(base, outer, room)
        try:
            before = contents(outer / "work")
            worker = worker if worker.alive else Worker(base)
            ended = worker.run(words, outer, limit)
            expected = expected or contents(outer / "work")
            _count(found, name, room, ended, outer, before, expected)
        finally:
            worker.leave()
            # A file of a verb that has failed may wait for the garbage collector.
            subprocess.run(["umount", "--lazy", outer], check=True)
    if worker.alive:
        worker.end()
    return found


def _mount(base: Path, outer: Path, room: object) -> None:
    """Mount a disk in memory with the whole files and so much room left."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=200m", "faults", outer], check=True)
    shutil.copytree(base / "original", outer / "work")
    disk = os.statvfs(outer)
    used = (disk.f_blocks - disk.f_bfree) * disk.f_frsize // 1024
    size = {"plenty": "size=200m", "none at all": "ro"}.get(str(room)) or f"size={used + int(str(room))}k"
    subprocess.run(["mount", "-o", f"remount,{size}", outer], check=True)


def _mount_with_quota(base: Path, outer: Path, room: object) -> None:
    """Mount a file with btrfs, the whole files, and a quota that leaves them so much room (needs btrfs-progs)."""
    image, work = base / "disk.btrfs", outer / "work"
    image.unlink(missing_ok=True)
    for command in (
        ("truncate", "--size", "300M", image),
        ("mkfs.btrfs", "--quiet", image),
        ("mount", "--options", "loop", image, outer),
        ("btrfs", "quota", "enable", outer),
        ("btrfs", "subvolume", "create", work),
    ):
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    shutil.copytree(base / "original", work, dirs_exist_ok=True)
    os.sync()
    if room != "plenty":
        shown = subprocess.run(["btrfs", "--format", "json", "qgroup", "show", "--raw", "-f", work], check=True,
                               capture_output=True)  # fmt: skip
        [group] = json.loads(shown.stdout)["qgroup-show"]
        most = int(group["referenced"]) + 1024 * int(str(room))
        subprocess.run(["btrfs", "qgroup", "limit", str(most), work], check=True)


def main() -> None:
    """Print what every verb did."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--verbs", nargs="*", default=list(VERBS))
    parser.add_argument("--most", type=int, default=10**6, help="states to continue, at least 2, where a verb is slow")
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--limit", action="store_const", dest="way", const=full)
    way.add_argument("--disk", action="store_const", dest="way", const=disks)
    way.add_argument("--quota", action="store_const", dest="way", const=partial(disks, quota=True))
    parser.set_defaults(way=kills)
    options = parser.parse_args()
    base = options.work.resolve()
    prepare(base)
    for name in options.verbs:
        found = options.way(base, name, 120.0, *([options.most] if options.way is kills else []))
        print(json.dumps({name: found}), flush=True)


if __name__ == "__main__":
    main()
