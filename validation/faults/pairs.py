"""Two processes of every pair of verbs on one folder at the same time.

`python -m validation.faults.pairs --work FOLDER` after `fuzz`, which makes the whole files in FOLDER. Each of the two
must do its work, or refuse it in one sentence; afterwards no file is half. Where one was refused, it must work, or be
refused again, when the other has ended.
"""

import argparse
import itertools
import json
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from validation.faults.fuzz import Worker, prepare
from validation.faults.kill import VERBS as WRITERS
from validation.faults.kill import fresh
from validation.faults.signals import ALSO

# Those whose writing is that of another one are left out.
_LEFT_OUT = ("data make of a toy", "train of KeyCLD", "bench figures", "export to mjcf", "export to mujoco-sysid",
             "export to lerobot", "models", "info", "bench status", "watch again")  # fmt: skip
VERBS = {name: words for name, words in {**WRITERS, **ALSO}.items() if name not in _LEFT_OUT}
# The run folder and the data that a pair with one of these shares.
_SHARED = {"demo": ("begun", "mujoco"), "watch": ("watched", "watched/data")}


def words_of(names: tuple[str, str], work: Path) -> list[list[str]]:
    """Return the words of two verbs that work on the same run and data."""
    run, data = next((_SHARED[name] for name in _SHARED if name in names), ("", "data"))
    shared = {"{work}/run": run or "run", "{work}/new": run or "new", "{work}/data": data}
    found = []
    for name in names:
        words = VERBS[name]
        for old, new in shared.items():
            words = tuple(word.replace(old, f"{work}/{new}") for word in words)
        found.append([word.replace("{work}", str(work)) for word in words])
    return found


def together(base: Path, workers: list[Worker], names: tuple[str, str], limit: float) -> dict[str, Any]:
    """Run two verbs at once and then one after the other, and return what happened."""
    outer = fresh(base)
    words = words_of(names, outer / "work")
    for k in range(2):
        workers[k] = workers[k] if workers[k].alive else Worker(base)
    with ThreadPoolExecutor(2) as threads:
        ends = list(threads.map(lambda worker, each: worker.run(each, outer, limit), workers, words))
    # `.partial` itself is unfinished work on data, which the next call continues.
    left = [str(path) for path in outer.rglob(".*partial") if path.name != ".partial"]
    again = []
    for each, end in zip(words, ends, strict=True):
        if end["exit"] == 0:
            continue
        workers[0] = workers[0] if workers[0].alive else Worker(base)
        again.append(workers[0].run(each, outer, limit))
    wrong = [end for end in ends + again if end["faults"] or end["unforeseen"]]
    said = [end["said"][-200:] for end in ends + again if end["exit"]]
    return {"pair": names, "exit": [end["exit"] for end in ends], "after": [end["exit"] for end in again], "said": said,
            "left": left, "wrong": wrong}  # fmt: skip


def main() -> None:
    """Print each pair, and how many ended in which way."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--verbs", nargs="*", default=list(VERBS))
    parser.add_argument("--with", nargs="*", dest="others", help="only pairs with one of these verbs")
    options = parser.parse_args()
    base = options.work.resolve()
    prepare(base)
    workers = [Worker(base), Worker(base)]
    done = []
    for names in itertools.combinations_with_replacement(options.verbs, 2):
        if options.others is not None and not set(names) & set(options.others):
            continue
        done.append(together(base, workers, names, 120.0))
        print(json.dumps(done[-1]), flush=True)
    for worker in workers:
        if worker.alive:
            worker.end()
    refused = sum(2 in each["exit"] for each in done)
    faults = sum(bool(each["wrong"] or each["left"]) for each in done)
    print(json.dumps({"pairs": len(done), "refused": refused, "faults": faults}), file=sys.stderr)


if __name__ == "__main__":
    main()
