"""Damaged files of every format for every verb that reads them.

`python -m validation.faults.fuzz --cases 10000 --seed 0 --work FOLDER` from the repository. A case is a function of the
seed and its number. Results are added to FOLDER/fuzz.jsonl, and the same command continues. Each case must end within
its time with code 0 or 2, and with one sentence if with 2. The time is that of the processor, because a machine may be
shared; a case may wait as well, but not long. A forked process runs many cases, in which imports and
compiled programs are warm; it is replaced when it hangs, dies or grows.
"""

import argparse
import contextlib
import io
import json
import os
import resource
import select
import shutil
import signal
import subprocess
import sys
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

from validation.faults.cases import chosen
from validation.faults.events import changed_path

REPOSITORY = Path(__file__).resolve().parents[2]
_EXTRA_SECONDS = 10.0
# Wall seconds for each second of the processor.
_WAITING = 8.0
_MOST_BYTES = 2e9
# A process with more bytes than this, or after this many cases, is replaced.
_GROWN, _ENOUGH = 1.2e9, 4000


class Worker:
    """A forked process that runs verbs one after the other."""

    def __init__(self, base: Path):
        self.cases = 0
        asked, self._ask = os.pipe()
        self._answers, answer = os.pipe()
        # A pipe: a limit on the size of files must not cut what is said.
        self._said, speaking = os.pipe()
        self._pid = os.fork()
        if self._pid == 0:
            for handle in (self._ask, self._answers, self._said):
                os.close(handle)
            _serve(base, asked, answer, speaking)
        for handle in (asked, answer, speaking):
            os.close(handle)
        os.set_blocking(self._said, False)

    def run(self, words: list[str], outer: Path, limit: float, largest: int = -1) -> dict[str, Any]:
        """Run one verb in the folder `outer`, and judge how it ends; afterwards `alive` says whether it goes on.

        Args:
            words: of the command.
            outer: the working directory.
            limit: seconds of the processor.
            largest: bytes that a file may have; -1: any.
        """
        since, before = time.monotonic(), _processor_seconds(self._pid)
        os.write(self._ask, json.dumps([words, str(outer), largest]).encode() + b"\n")
        said, answer, hung = bytearray(), b"", False
        while not answer.endswith(b"\n"):
            ready = select.select([self._answers, self._said], [], [], 0.2)[0]
            said += _drained(self._said)
            if self._answers in ready:
                part = os.read(self._answers, 2**16)
                if not part:
                    break
                answer += part
            used = _processor_seconds(self._pid) - before
            hung = used > limit or time.monotonic() > since + _WAITING * limit
            if hung:
                break
        said += _drained(self._said)
        used = _processor_seconds(self._pid) - before
        self.cases += 1
        if answer.endswith(b"\n"):
            code, peak, outside = json.loads(answer)
            if peak > _GROWN or self.cases == _ENOUGH:
                self.end()
        else:
            code, peak, outside = self.end(), 0, []
        found = judged(code, hung, bytes(said), peak, since)
        return found | {"outside": outside, "processor_seconds": round(used, 2)}

    def leave(self) -> None:
        """Leave the folder of the last verb."""
        if self.alive:
            self.run(["--version"], Path("/"), 10.0)

    @property
    def alive(self) -> bool:
        """Whether the process can run another verb."""
        return self._pid > 0

    def end(self) -> int:
        """End the process and return its code."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._pid, signal.SIGKILL)
        _, status = os.waitpid(self._pid, 0)
        for handle in (self._ask, self._answers, self._said):
            os.close(handle)
        self._pid = 0
        return os.waitstatus_to_exitcode(status)


def _serve(base: Path, asked: int, answer: int, speaking: int) -> None:
    """Run verbs in this process until nobody asks."""
    _detach(speaking)
    outer = ""
    outside: list[str] = []

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        path = changed_path(event, arguments)
        if path is not None and not path.startswith((f"{outer}/work", str(base / "tmp"), "/dev/", "/proc/")):
            outside.append(path)

    sys.addaudithook(watch)
    with os.fdopen(asked) as orders:
        for line in orders:
            words, outer, largest = json.loads(line)
            outside.clear()
            os.chdir(outer)
            Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest, resource.RLIM_INFINITY))
            code = exit_code(words)
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            status = Path("/proc/self/status").read_text()
            peak = int(status.partition("VmHWM:")[2].split()[0]) * 1024
            os.write(answer, json.dumps([code, peak, outside[:5]]).encode() + b"\n")
    os._exit(0)


def run_case(worker: Worker, number: int, seed: int, base: Path, usual: dict[str, float]) -> dict[str, Any]:
    """Damage a copy of the originals, run the verb, and return what happened."""
    from validation.faults.mutate import MARK, damage

    target, words = chosen(number, seed)
    # A folder of its own: nothing may be remembered by its path.
    case = base / "case" / str(number)
    outer = case / "a" / "b" / "c"
    outer.mkdir(parents=True)
    shutil.copytree(base / "original", outer / "work")
    for name in target.without:
        (outer / "work" / name).unlink()
    done = damage(outer / "work" / target.file, seed * 10**6 + number)
    limit = usual[" ".join(words)] + _EXTRA_SECONDS
    found = worker.run([word.replace("{work}", str(outer / "work")) for word in words], outer, limit)
    strangers = [path for path in case.rglob("*") if outer / "work" not in (path, *path.parents)]
    found["outside"] += [str(path) for path in strangers if path not in (outer, *outer.parents)]
    pages = [path.read_text(errors="replace") for path in (outer / "work").rglob("*.html") if path.is_file()]
    found["faults"] += ["injection"] if any(MARK in page for page in pages) else []
    shutil.rmtree(case)
    return {"case": number, "file": target.file, "damage": done, "words": " ".join(words),
            **found}  # fmt: skip


def run_verb(words: list[str], outer: Path, limit: float) -> dict[str, Any]:
    """Run one verb in a forked process of its own, and judge how it ends."""
    since = time.monotonic()
    listening, speaking = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(listening)
        _detach(speaking)
        os.chdir(outer)
        os._exit(exit_code(words))
    os.close(speaking)
    os.set_blocking(listening, False)
    status, usage, said, hung = _wait(child, since + limit, listening)
    os.close(listening)
    found = judged(os.waitstatus_to_exitcode(status), hung, said, usage.ru_maxrss * 1024, since)
    return found | {"processor_seconds": round(usage.ru_utime + usage.ru_stime, 2)}


def judged(code: int, hung: bool, said: bytes, peak: int, since: float) -> dict[str, Any]:
    """Return how a verb ended, and what is wrong with that."""
    text = said.decode(errors="replace")
    verdicts = {
        "hang": hung,
        "crash": code < 0 and not hung,
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


def _detach(speaking: int) -> None:
    """Give this process a group of its own, no input, and the pipe for what it says."""
    os.setpgid(0, 0)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    os.dup2(speaking, 2)


def exit_code(words: list[str]) -> int:
    """Run a verb in this process and return the code with which it would end.

    `child ROOT RESULTS` is what `bench run` starts for a small experiment; it says what it records for `bench run`.
    """
    from keycld.cli.main import main

    try:
        if words[0] == "child":
            return _child(*words[1:])
        return main(words)
    except SystemExit as error:
        return int(error.code or 0)
    except BaseException:
        traceback.print_exc()
        return 70
    finally:
        sys.stderr.flush()


def _child(root: str, results: str) -> int:
    from validation.faults.originals import small_experiment

    from keycld import KeycldError
    from keycld._compile_cache import use_compile_cache
    from keycld.benchmarks import Place
    from keycld.benchmarks.child import main as child
    from keycld.benchmarks.running import TAKEN
    from keycld.benchmarks.status import remove_leftovers

    # As `bench run` does, which starts it.
    use_compile_cache()
    experiment = small_experiment()
    remove_leftovers(experiment, Place(Path(root), Path(results)))
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            code = child([str(os.getppid()), experiment.to_json(), root, results])
        if code == TAKEN:  # another process does it, which `bench run` says
            return 0
        failure = Place(Path(root), Path(results)).failure(experiment)
        said = json.loads(failure.read_text())["sentence"] if code else ""
    except KeycldError as error:
        code, said = 2, str(error)
    if code:
        print(f"keycld: {said}", file=sys.stderr)
    return 2 if code else 0


def _processor_seconds(pid: int) -> float:
    """Return what a process and those that it has waited for have used."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def _drained(handle: int) -> bytes:
    said = bytearray()
    with contextlib.suppress(BlockingIOError):
        while part := os.read(handle, 2**16):
            said += part
    return bytes(said)


def _wait(child: int, until: float, listening: int) -> tuple[int, Any, bytes, bool]:
    said = bytearray()
    while True:
        pid, status, usage = os.wait4(child, os.WNOHANG)
        said += _drained(listening)
        if pid:
            return status, usage, bytes(said), False
        if time.monotonic() > until:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)
            _, status, usage = os.wait4(child, 0)
            return status, usage, bytes(said), True
        time.sleep(0.005)


def usual_seconds(words: tuple[str, ...], base: Path) -> float:
    """Return how many seconds of the processor a verb takes on whole files in a new process."""
    outer = base / "case" / "whole"
    shutil.rmtree(outer, ignore_errors=True)
    outer.mkdir(parents=True)
    shutil.copytree(base / "original", outer / "work")
    found = run_verb([word.replace("{work}", str(outer / "work")) for word in words], outer, 300.0)
    seconds = found["processor_seconds"]
    print(f"{' '.join(words)}: {seconds} s on whole files, exit {found['exit']}", file=sys.stderr, flush=True)
    assert found["exit"] in (0, 2) and not found["faults"], found
    return seconds


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
        "by_file_and_verb": dict(sorted(Counter(f"{line['file']}: {_verb(line['words'])}" for line in lines).items())),
    }


def _verb(words: str) -> str:
    """Return `train` or `data check` of the words of a command."""
    return " ".join(word for word in words.split()[:2] if word.isalpha())


def main() -> None:
    """Run the cases that are not done."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", help="first words of verbs, or files; by default all")
    parser.add_argument("--work", type=Path, required=True)
    options = parser.parse_args()
    base = options.work.resolve()
    prepare(base)
    shutil.rmtree(base / "case", ignore_errors=True)
    memory = base / "usual.json"
    usual: dict[str, float] = json.loads(memory.read_text()) if memory.exists() else {}
    path = base / "fuzz.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    known = {line["case"] for line in lines}
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=REPOSITORY, capture_output=True, text=True)
    worker = Worker(base)
    with path.open("a") as file:
        for number in range(options.first, options.first + options.cases):
            target, words = chosen(number, options.seed)
            if number in known or (options.only and not {words[0], target.file} & set(options.only)):
                continue
            if " ".join(words) not in usual:
                usual[" ".join(words)] = usual_seconds(words, base)
                memory.write_text(json.dumps(usual))
            worker = worker if worker.alive else Worker(base)
            found = run_case(worker, number, options.seed, base, usual)
            lines.append(found | {"commit": commit.stdout.strip()})
            file.write(json.dumps(lines[-1]) + "\n")
            file.flush()
    print(json.dumps(summary(lines), indent=1))


def prepare(base: Path) -> None:
    """Make the whole files, and import what the verbs need; JAX begins in forked processes only."""
    (base / "tmp").mkdir(parents=True, exist_ok=True)
    os.environ |= {"TMPDIR": str(base / "tmp"), "MPLCONFIGDIR": str(base / "tmp" / "matplotlib"),
                   "KEYCLD_COMPILE_CACHE": str(base / "tmp" / "compiled"),
                   # Programs that compile fast are worth a file here: each verb runs very often.
                   "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}  # fmt: skip
    if not (base / "original").exists():
        code = "import sys; from pathlib import Path; from validation.faults.originals import make_originals as m; "
        code += "m(Path(sys.argv[1]), Path(sys.argv[2]))"
        shutil.rmtree(base / "new", ignore_errors=True)
        subprocess.run([sys.executable, "-c", code, str(base / "new"), str(REPOSITORY)], check=True)
        (base / "new").rename(base / "original")
    import keycld.benchmarks
    import keycld.cli.main
    import keycld.control
    import keycld.data
    import keycld.evaluation
    import keycld.reports
    import keycld.training  # noqa: F401


if __name__ == "__main__":
    main()
