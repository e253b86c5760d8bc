"""An interrupt or a termination at random moments of every verb.

`python -m validation.faults.signals --work FOLDER --tries 20` after `fuzz`, which makes the whole files in FOLDER. A
process in which everything is imported already is forked for each try, so that the moments, which are random over the
time that the verb takes, are those of its work; `tests/test_faults.py` interrupts the import. Each try must end with
code 130 or 143, soon, without a traceback, and without a process that goes on; one in which the verb was faster is
repeated. After the last try the same command must do its work with what the try has left.
"""

import argparse
import contextlib
import json
import math
import os
import shutil
import signal
import sys
import time
from collections import Counter
from pathlib import Path
from random import Random

from validation.faults.fuzz import Worker, exit_code, prepare
from validation.faults.kill import VERBS, fresh

ALSO: dict[str, tuple[str, ...]] = {
    "data check": ("data", "check", "{work}/data"),
    "watch again": tuple(word.replace("/new", "/watched") for word in VERBS["watch"]),
    "models": ("models",),
    "info": ("info",),
    "bench status": ("bench", "status", "keycld", "--root", "{work}/bench", "--results", "{work}/results"),
}
_SOON = 5.0


def begun(words: list[str], outer: Path) -> tuple[int, int]:
    """Begin a verb as the installed command does, in a process of its own; return its number and what it says."""
    listening, speaking = os.pipe()
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        nothing = os.open(os.devnull, os.O_RDWR)
        for handle, place in ((nothing, 0), (nothing, 1), (speaking, 2)):
            os.dup2(handle, place)
        os.chdir(outer)
        # A shell starts background processes with interrupts ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        from keycld._signals import ENDING, end_on_signals

        end_on_signals()
        os.write(2, b"\n")
        code = exit_code(words)
        if ENDING.is_set():
            time.sleep(60)  # the other thread ends the process
        os._exit(code)
    os.close(speaking)
    # Before the first line of ours, Python itself ends.
    os.read(listening, 1)
    os.set_blocking(listening, False)
    return child, listening


def waited(child: int, listening: int, seconds: float) -> tuple[int | None, bytes]:
    """Wait for a process; return its code, None if it still runs, and what it has said."""
    until, said = time.monotonic() + seconds, bytearray()
    while True:
        pid, status = os.waitpid(child, os.WNOHANG)
        try:
            while part := os.read(listening, 2**16):
                said += part
        except BlockingIOError:
            pass
        if pid:
            return os.waitstatus_to_exitcode(status), bytes(said)
        if time.monotonic() > until:
            return None, bytes(said)
        time.sleep(0.01)


def attempt(words: list[str], outer: Path, number: signal.Signals, pause: float) -> tuple[str | None, float]:
    """Return the code of one try, or what is wrong with its end; and how long the end took.

    The code is None if the verb was faster than the signal.
    """
    child, listening = begun(words, outer)
    code, said = waited(child, listening, pause)
    since, late = time.monotonic(), code is not None
    if not late:
        os.kill(child, number)
        code, more = waited(child, listening, 8 * _SOON)
        said += more
    if code is None:
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
    os.close(listening)
    took = time.monotonic() - since
    until = time.monotonic() + _SOON
    while (left := left_behind(outer)) and time.monotonic() < until:
        time.sleep(0.05)
    verdicts = {"hang": code is None, "traceback": b"Traceback" in said, "left a process": left}
    wrong = next((verdict for verdict, holds in verdicts.items() if holds), "")
    return (wrong or (None if late else str(code))), took


def left_behind(outer: Path) -> bool:
    """Tell whether a process still works in a folder."""
    for place in Path("/proc").glob("[0-9]*/cwd"):
        with contextlib.suppress(OSError):
            if place.readlink() == outer:
                return True
    return False


def usual_seconds(base: Path, words: list[str]) -> float:
    """Return how long a verb takes on whole files."""
    whole = math.inf
    for _ in range(2):  # the first call may have to compile
        since = time.monotonic()
        child, listening = begun(words, fresh(base))
        waited(child, listening, 300.0)
        os.close(listening)
        whole = min(whole, time.monotonic() - since)
    return whole


def tries(base: Path, words: list[str], number: signal.Signals, count: int, whole: float, random: Random) -> dict:
    """Interrupt a verb at random moments, each time with the whole files; a whole run continues what the last left."""
    outer = fresh(base)
    ends, longest = Counter(), 0.0
    for _ in range(3 * count):
        shutil.rmtree(outer / "work", ignore_errors=True)
        shutil.copytree(base / "original", outer / "work")
        end, took = attempt(words, outer, number, random.uniform(0.0, whole))
        if end is not None:
            ends[end] += 1
            longest = max(longest, took)
        if ends.total() == count:
            break
    worker = Worker(base)
    again = worker.run(words, outer, 120.0)
    if worker.alive:
        worker.end()
    found = {"seconds": round(whole, 2), "ends": dict(ends), "slowest_end": round(longest, 2)}
    done = again["exit"] == 0 or "already holds data" in again["said"]
    return found | ({} if done and not again["faults"] else {"not_resumed": again})


def main() -> None:
    """Print how often each verb ended in which way."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--tries", type=int, default=20)
    parser.add_argument("--verbs", nargs="*", default=[*VERBS, *ALSO])
    options = parser.parse_args()
    base = options.work.resolve()
    prepare(base)
    for name in options.verbs:
        words = [word.replace("{work}", str(base / "case/a/work")) for word in {**VERBS, **ALSO}[name]]
        whole = usual_seconds(base, words)
        for number in (signal.SIGINT, signal.SIGTERM):
            found = tries(base, words, number, options.tries, whole, Random(f"{name} {number.name}"))
            print(json.dumps({name: {number.name: found}}), flush=True)


if __name__ == "__main__":
    sys.exit(main())
