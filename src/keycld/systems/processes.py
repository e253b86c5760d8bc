"""Fresh worker processes for drawing: at most four, each with a time-out and one retry.

Workers are new interpreters, never forks (JAX and GL do not survive one), and they do not import the caller's main
script, so plain scripts and notebooks may call this without a guard. A worker ends with its parent, however that ends.
"""

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from keycld._errors import KeycldError

# More renderers at once were seen to hang on some GPU drivers (mujoco issue 3444).
MAX_WORKERS = 4
TIME_OUT = 300.0


class _Lost(Exception):
    """A worker died or did not answer in time."""


class _Worker:
    """One interpreter that answers one task at a time."""

    def __init__(self):
        environment = dict(os.environ)
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "keycld.systems.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
        )
        assert self._process.stdin is not None and self._process.stdout is not None
        self._tasks = Connection(os.dup(self._process.stdin.fileno()), readable=False)
        self._answers = Connection(os.dup(self._process.stdout.fileno()), writable=False)
        self._process.stdin.close()
        self._process.stdout.close()

    def run(self, function: Callable[..., Any], arguments: tuple, time_out: float) -> Any:
        try:
            self._tasks.send((function, arguments))
            if not self._answers.poll(time_out):
                raise _Lost(f"no answer in {time_out:.0f} s")
            answer = self._answers.recv()
        except (EOFError, OSError) as error:
            raise _Lost(f"its process ended with code {self._process.wait()}") from error
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def close(self) -> None:
        for connection in (self._tasks, self._answers):
            with suppress(OSError):
                connection.close()
        self._process.kill()
        self._process.wait()


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_in_processes(
    function: Callable[..., Any],
    tasks: Sequence[tuple],
    *,
    workers: int | None = None,
    time_out: float = TIME_OUT,
) -> Iterator[tuple[int, Any]]:
    """Yield (index, `function(*tasks[index])`) as they finish, in any order.

    **Arguments:** `function`: importable by name; `workers`: processes (default: one a core), at most four;
    `time_out`: seconds for one task. A task whose worker dies or hangs is tried once more in a fresh one.

    **Raises:** what the function raises; `KeycldError` where the second try is lost too.
    """
    if workers is not None and workers < 1:
        raise KeycldError(f"workers must be at least 1, not {workers}.")
    count = max(1, min(MAX_WORKERS, workers or cores(), len(tasks)))
    local, alive, lock = threading.local(), [], threading.Lock()

    def worker() -> _Worker:
        if getattr(local, "worker", None) is None:
            local.worker = _Worker()
            with lock:
                alive.append(local.worker)
        return local.worker

    def attempt(index: int) -> tuple[int, Any]:
        for last in (False, True):
            try:
                return index, worker().run(function, tasks[index], time_out)
            except _Lost as error:
                local.worker.close()
                local.worker = None
                if last:
                    raise KeycldError(
                        f"a renderer process failed twice ({error}): try fewer workers, or another GL driver through "
                        "MUJOCO_GL."
                    ) from error
        raise AssertionError("unreachable")

    with ThreadPoolExecutor(count) as pool:
        futures = [pool.submit(attempt, index) for index in range(len(tasks))]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            for future in futures:
                future.cancel()
            for each in alive:
                each.close()
