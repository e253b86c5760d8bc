"""Damaged files of every format for every verb that reads them.

`python -m validation.faults.fuzz --cases 10000 --seed 0 --work FOLDER` from the repository. A case is a function of the
seed and its number. Results are added to FOLDER/fuzz.jsonl, and the same command continues. Each case runs in a forked
process, which must end within its time with code 0 or 2, and with one sentence if with 2.
"""

import argparse
import contextlib
import json
import os
import resource
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[2]
_EXTRA_SECONDS = 10.0
_MOST_BYTES = 2e9


def chosen(number: int, seed: int) -> tuple[Any, tuple[str, ...]]:
    """Return file and verb of a case: each file in turn, then each of its verbs."""
    from validation.faults.cases import TARGETS

    target = TARGETS[number % len(TARGETS)]
    return target, target.verbs[(number // len(TARGETS) + seed) % len(target.verbs)]


def run_case(number: int, seed: int, base: Path, usual: dict[str, float]) -> dict[str, Any]:
    """Damage a copy of the originals, run the verb, and return what happened."""
    from validation.faults.mutate import damage

    target, words = chosen(number, seed)
    outer = base / "case" / "a" / "b" / "c"
    shutil.rmtree(base / "case", ignore_errors=True)
    outer.mkdir(parents=True)
    shutil.copytree(base / "original", outer / "work")
    done = damage(outer / "work" / target.file, seed * 10**6 + number)
    limit = usual[" ".join(words)] + _EXTRA_SECONDS
    found = run_verb([word.replace("{work}", str(outer / "work")) for word in words], outer, base, limit)
    strangers = [str(path) for path in (base / "case").rglob("*") if outer / "work" not in (path, *path.parents)]
    strangers = [path for path in strangers if Path(path) not in (outer, *outer.parents)]
    return {"case": number, "file": target.file, "verb": " ".join(words[:2]), "damage": done, "outside": strangers,
            "words": " ".join(words), **found}  # fmt: skip


def run_verb(
    words: list[str], outer: Path, base: Path, limit: float, first: Callable[[], object] = lambda: None
) -> dict[str, Any]:
    """Run one verb in a forked process, which calls `first` before, and judge how it ends."""
    since = time.monotonic()
    # A pipe: a limit on the size of files must not cut what is said.
    listening, speaking = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(listening)
        _become(words, outer, base, first, speaking)
    os.close(speaking)
    os.set_blocking(listening, False)
    status, usage, said = _wait(child, since + limit, listening)
    os.close(listening)
    code = os.waitstatus_to_exitcode(status)
    text = said.decode(errors="replace")
    peak = usage.ru_maxrss * 1024
    verdicts = {
        "hang": code == -signal.SIGKILL,
        "crash": code < 0 and code != -signal.SIGKILL,
        "traceback": "Traceback" in text,
        "code": code not in (0, 2) and code >= 0,
        "no sentence": code == 2 and "keycld: " not in text and "─" not in text,
        "memory": peak > _MOST_BYTES,
    }
    return {
        "exit": code, "seconds": round(time.monotonic() - since, 2), "peak": peak,
        "faults": [name for name, holds in verdicts.items() if holds], "unforeseen": "did not foresee" in text,
        "said": text.strip()[-400:],
    }  # fmt: skip


def _become(words: list[str], outer: Path, base: Path, first: Callable[[], object], handle: int) -> None:
    """Run the verb in this process, which ends."""
    os.setpgid(0, 0)
    os.chdir(outer)
    os.environ["TMPDIR"] = str(base / "tmp")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    os.dup2(handle, 2)
    code = 70
    try:
        from keycld.cli.main import main

        first()
        code = main(words)
    except SystemExit as error:
        code = int(error.code or 0)
    finally:
        with contextlib.suppress(Exception):
            sys.stderr.flush()
        os._exit(code)


def _wait(child: int, until: float, listening: int) -> tuple[int, Any, bytes]:
    said = bytearray()
    while True:
        pid, status, usage = os.wait4(child, os.WNOHANG)
        with contextlib.suppress(BlockingIOError):
            while part := os.read(listening, 2**16):
                said += part
        if pid:
            return status, usage, bytes(said)
        if time.monotonic() > until:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)
            _, status, usage = os.wait4(child, 0)
            return status, usage, bytes(said)
        time.sleep(0.005)


def usual_seconds(words: tuple[str, ...], base: Path) -> float:
    """Return how long a verb takes on whole files."""
    outer = base / "case" / "whole"
    shutil.rmtree(base / "case", ignore_errors=True)
    outer.mkdir(parents=True)
    shutil.copytree(base / "original", outer / "work")
    found = run_verb([word.replace("{work}", str(outer / "work")) for word in words], outer, base, 300.0)
    print(f"{' '.join(words)}: {found['seconds']} s on whole files, exit {found['exit']}", file=sys.stderr, flush=True)
    assert found["exit"] in (0, 2) and not found["faults"], found
    return found["seconds"]


def summary(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """Count cases, verdicts and the largest figures."""
    return {
        "cases": len(lines),
        "exit": dict(Counter(str(line["exit"]) for line in lines)),
        "faults": dict(Counter(fault for line in lines for fault in line["faults"])),
        "unforeseen": sum(line["unforeseen"] for line in lines),
        "outside": sum(bool(line["outside"]) for line in lines),
        "longest_seconds": max((line["seconds"] for line in lines), default=0.0),
        "largest_bytes": max((line["peak"] for line in lines), default=0),
        "by_file": dict(Counter(line["file"] for line in lines)),
    }


def main() -> None:
    """Run the cases that are not done."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", help="first words of the verbs to run; by default all")
    parser.add_argument("--work", type=Path, required=True)
    options = parser.parse_args()
    base = options.work.resolve()
    (base / "tmp").mkdir(parents=True, exist_ok=True)
    if not (base / "original").exists():
        # In a process of its own: JAX may not have begun in the one that forks.
        code = "import sys; from pathlib import Path; from validation.faults.cases import make_originals as m; "
        code += "m(Path(sys.argv[1]), Path(sys.argv[2]))"
        os.spawnv(os.P_WAIT, sys.executable, [sys.executable, "-c", code, str(base / "new"), str(REPOSITORY)])
        (base / "new").rename(base / "original")
    prepare()
    usual: dict[str, float] = {}
    path = base / "fuzz.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    known = {line["case"] for line in lines}
    with path.open("a") as file:
        for number in range(options.first, options.first + options.cases):
            _, words = chosen(number, options.seed)
            if number in known or (options.only and words[0] not in options.only):
                continue
            if " ".join(words) not in usual:
                usual[" ".join(words)] = usual_seconds(words, base)
            lines.append(run_case(number, options.seed, base, usual))
            file.write(json.dumps(lines[-1]) + "\n")
            file.flush()
    print(json.dumps(summary(lines), indent=1))


def prepare() -> None:
    """Import what the verbs need, so that forked processes begin at once; JAX begins in each of them."""
    import keycld.benchmarks
    import keycld.cli.main
    import keycld.control
    import keycld.data
    import keycld.evaluation
    import keycld.reports
    import keycld.training  # noqa: F401


if __name__ == "__main__":
    main()
