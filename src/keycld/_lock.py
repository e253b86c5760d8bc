"""A lock in a file that ends with the process that holds it, also if that process is killed."""

import contextlib
import fcntl
import json
import os
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, TypedDict

from keycld._files import alive, make_folder, remove_orphans, writing_error
from keycld._records import checked

_BEAT_SECONDS = 10.0


class _Note(TypedDict):
    pid: int
    host: str
    since: float


class Holder(NamedTuple):
    """The holder of a lock.

    Attributes:
        pid: its process.
        host: its machine.
        age: seconds since it took the lock.
        silent: seconds since it last touched the file.
    """

    pid: int
    host: str
    age: float
    silent: float


@contextlib.contextmanager
def locked(path: Path, *, wait: bool = False) -> Iterator[bool]:
    """Hold the lock in the file `path`; yields False if another process holds it.

    The kernel releases the lock when the process ends, so a killed one leaves nothing to clean up. The file stays; it
    names the holder, and a thread touches it every ten seconds.

    Args:
        path: file of the lock.
        wait: wait until the lock is free.

    Raises:
        KeycldError: the file cannot be written.
    """
    make_folder(path.parent)
    try:
        opened = path.open("a+")
    except OSError as error:
        raise writing_error(path, error) from error
    with opened as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        note = json.dumps({"pid": os.getpid(), "host": socket.gethostname(), "since": time.time()})
        try:
            file.truncate(0)
            # Without a buffer, which would be written again when the file is closed.
            os.write(file.fileno(), note.encode())
        except OSError as error:
            raise writing_error(path, error) from error
        done = threading.Event()
        beat = threading.Thread(target=_beat, args=(path, done), daemon=True)
        beat.start()
        try:
            yield True
        finally:
            done.set()
            beat.join()
            file.truncate(0)


@contextlib.contextmanager
def alone(folder: Path, doing: str = "makes data", lock: str = ".lock") -> Iterator[None]:
    """Wait until no other process does the same in a folder, and keep others waiting.

    Args:
        folder: the folder.
        doing: what, for the line that says so.
        lock: name of the lock's file.

    Raises:
        KeycldError: as `locked`.
    """
    with contextlib.ExitStack() as held:
        if not held.enter_context(locked(folder / lock)):
            print(f"waiting for another process that {doing} in {folder}", file=sys.stderr, flush=True)
            held.enter_context(locked(folder / lock, wait=True))
        remove_orphans(folder)
        yield


def holder(path: Path) -> Holder | None:
    """Return the holder of the lock in the file `path`, or None."""
    try:
        with path.open() as file:
            text = file.read(1000)
            if not text:
                return None
            found = checked(json.loads(text), _Note)
            if found["host"] == socket.gethostname() and not alive(found["pid"]):
                return None
            try:  # by now another process may have this number
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
                return None
            except BlockingIOError:
                now = time.time()
                silent = max(0.0, now - path.stat().st_mtime)
                return Holder(found["pid"], found["host"], now - found["since"], silent)
    except (FileNotFoundError, ValueError):  # ValueError: the file is being written
        return None


def _beat(path: Path, done: threading.Event) -> None:
    while not done.wait(_BEAT_SECONDS):
        with contextlib.suppress(OSError):
            os.utime(path)
