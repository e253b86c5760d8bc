"""An interrupt or a termination at a random moment of every verb, in a process of its own.

`python -m validation.faults.signals --work FOLDER --tries 20` after `fuzz`, which makes the whole files in FOLDER. Each
try must end with code 130 or 143 (or 0 where the verb was faster) and without a traceback; the same command must then
end with code 0.
"""

import argparse
import json
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from random import Random

from validation.faults.kill import VERBS, fresh

ALSO: dict[str, tuple[str, ...]] = {
    "data make": ("data", "make", "toy/pendulum", "--train", "40", "--test", "2", "--long", "2", "--out", "{work}/new"),
    "data check": ("data", "check", "{work}/data"),
    "eval": ("eval", "{work}/run", "--data", "{work}/data", "--protocols", "test@10"),
    "train": ("train", "{work}/data", "--config", "{work}/run/config.json", "--out", "{work}/other"),
}


def attempt(base: Path, words: tuple[str, ...], number: signal.Signals, pause: float) -> str:
    """Return what is wrong with the end of one try, or its code."""
    outer = fresh(base)
    # A shell starts background processes with interrupts ignored.
    program = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    program += "from keycld.cli.start import entry; entry()"
    command = [sys.executable, "-c", program, *(word.replace("{work}", str(outer / "work")) for word in words)]
    process = subprocess.Popen(command, cwd=outer, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    time.sleep(pause)
    process.send_signal(number)
    try:
        _, said = process.communicate(timeout=30)
    except subprocess.TimeoutExpired:
        process.kill()
        return "hang"
    if "Traceback" in said:
        return "traceback"
    if process.returncode == 0:
        return "0"
    again = subprocess.run(command, cwd=outer, capture_output=True, text=True, check=False)
    if again.returncode != 0 and "already holds data" not in again.stderr:
        return f"not resumed: {again.stderr[-200:]}"
    return str(process.returncode)


def main() -> None:
    """Print how often each verb ended in which way."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--tries", type=int, default=20)
    parser.add_argument("--verbs", nargs="*", default=[*VERBS, *ALSO])
    options = parser.parse_args()
    random = Random(0)
    for name in options.verbs:
        for number in (signal.SIGINT, signal.SIGTERM):
            moments = [random.uniform(0.3, 4.0) for _ in range(options.tries)]
            ends = Counter(attempt(options.work.resolve(), {**VERBS, **ALSO}[name], number, each) for each in moments)
            print(json.dumps({name: {number.name: dict(ends)}}), flush=True)


if __name__ == "__main__":
    main()
