"""Fresh worker processes for rendering: at most four, each with a time-out and one retry.

Workers are new interpreters, never forks (JAX and GL do not survive one), and they do not import the
caller's main script, so plain scripts and notebooks may call this without a guard. A worker ends with its
parent, however that ends.
"""

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from keycld._errors import KeycldError

# More renderers at once were seen to hang on some GPU drivers (mujoco issue 3444).
MAX_WORKERS = 4
TIME_OUT = 300.0


class Task(NamedTuple):
    """A call for a worker: an importable function and its arguments, both pickled."""

    function: Callable[..., Any]
    arguments: tuple


class _Lost(Exception):
    """A worker died or did not answer in time."""


class _Worker:
    """One interpreter that does one task at a time."""

    def __init__(self):
        environment = {
            **os.environ,
            # An empty entry is the folder in which this process began.
            "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path),
            # The workers fill the cores: threads inside each software renderer would only get in their way.
            "LP_NUM_THREADS": os.environ.get("LP_NUM_THREADS", "0"),
            # What they compute is small and sequential, and a GPU may have neither memory nor contexts left for them.
            "JAX_PLATFORMS": "cpu",
        }
        self._process = subprocess.Popen(
            # Without -P a package in the working folder would come before the installed ones.
            [sys.executable, "-P", "-m", "keycld.systems.worker", str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            # An interrupt at the keyboard reaches the parent alone, with which the worker ends.
            process_group=0,
        )
        # Connection frames whole pickled objects and can wait with a time-out, which plain pipes cannot.
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None and stdout is not None
        self._tasks = Connection(os.dup(stdin.fileno()), readable=False)
        self._answers = Connection(os.dup(stdout.fileno()), writable=False)
        stdin.close()
        stdout.close()

    def run(self, task: Task, time_out: float) -> Any:
        """Return the result of the task; raise what the task raised, or `_Lost`."""
        try:
            self._tasks.send(tuple(task))
            if not self._answers.poll(time_out):
                raise _Lost(f"no answer in {time_out:.0f} s")
            answer = self._answers.recv()
        except (EOFError, OSError) as error:
            raise _Lost(f"its process ended with code {self._process.wait()}") from error
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def close(self) -> None:
        """End the process."""
        for connection in (self._tasks, self._answers):
            with suppress(OSError):
                connection.close()
        self._process.kill()
        self._process.wait()


class _Crew:
    """One worker for each thread of the pool, made when it is first needed."""

    def __init__(self, time_out: float):
        self._time_out = time_out
        self._workers: dict[int, _Worker] = {}
        self._dismissed = False

    def run(self, task: Task) -> Any:
        try:
            return self._attempt(task)
        except _Lost:
            pass
        try:
            return self._attempt(task)
        except _Lost as error:
            raise KeycldError(
                f"a renderer process failed twice ({error}): try fewer workers, or another driver (MUJOCO_GL)."
            ) from error

    def _attempt(self, task: Task) -> Any:
        thread = threading.get_ident()
        if self._dismissed:
            raise _Lost("the job was given up")
        if thread not in self._workers:
            self._workers[thread] = _Worker()
        try:
            return self._workers[thread].run(task, self._time_out)
        except _Lost:
            self._workers.pop(thread).close()
            raise

    def dismiss(self) -> None:
        """End all workers; tasks under way are lost."""
        self._dismissed = True
        for worker in list(self._workers.values()):
            worker.close()


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def run_in_processes(
    tasks: Sequence[Task], *, workers: int | None = None, time_out: float = TIME_OUT
) -> Generator[tuple[int, Any], None, None]:
    """Yield (index, result) of each task when it is done, in any order.

    A task whose worker dies or hangs is tried once more in a fresh one. Closing the generator ends the workers.

    Args:
        tasks: what to do.
        workers: processes, at most four; by default one a core.
        time_out: seconds for one task.

    Raises:
        KeycldError: `workers` is below 1, or a task's second try is lost too. Other errors are the task's own.
    """
    count = min(_worker_count(workers), max(1, len(tasks)))
    crew = _Crew(time_out)
    pool = ThreadPoolExecutor(count)
    futures = {pool.submit(crew.run, task): index for index, task in enumerate(tasks)}
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        crew.dismiss()
        pool.shutdown(cancel_futures=True)
        crew.dismiss()  # a worker may have started while the others ended


class Workers:
    """Processes that stay for many short rounds of tasks, as a control loop needs them; close them at the end.

    Args:
        workers: processes, at most four; by default one a core.
        time_out: seconds for one task.

    Raises:
        KeycldError: `workers` is below 1.
    """

    def __init__(self, workers: int | None = None, time_out: float = TIME_OUT):
        self.count = _worker_count(workers)
        self._crew = _Crew(time_out)
        self._pool = ThreadPoolExecutor(self.count)

    def run(self, tasks: Sequence[Task]) -> list[Any]:
        """Return the results in the order of the tasks; raise what a task raised."""
        return list(self._pool.map(self._crew.run, tasks))

    def close(self) -> None:
        """End the processes."""
        self._crew.dismiss()
        self._pool.shutdown(cancel_futures=True)


def check_workers(workers: int | None) -> None:
    """Refuse a number of worker processes that is not positive; None is what suits the machine.

    Raises:
        KeycldError: names the option.
    """
    if workers is not None and workers < 1:
        raise KeycldError(f"--workers is at least 1, not {workers}.")


def _worker_count(workers: int | None) -> int:
    check_workers(workers)
    return min(MAX_WORKERS, workers or cores())
