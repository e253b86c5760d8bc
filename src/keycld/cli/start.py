"""The installed command: how it begins, and how it ends when a signal or something unforeseen stops it."""

import contextlib
import os
import signal
import sys
import tempfile
import threading
import traceback

from keycld._files import discard_partial

_ENDING = threading.Event()


def entry() -> None:
    """Run the installed command `keycld`."""
    end_on_signals()
    from keycld.cli.main import main

    code = main()
    if _ENDING.is_set():
        threading.Event().wait()  # the other thread ends the process
    sys.exit(code)


def end_on_signals() -> None:
    """End the process with code 130 at an interrupt and 143 at a termination, wherever it is.

    Everything on the disk survives a kill, so nothing need be unwound: an exception would have to pass through
    compiled code, which may crash or lose it. A thread of its own does not wait for long compilations either.
    """
    numbers = [each for each in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(each) is not signal.SIG_IGN]
    arrived, wake = os.pipe()
    os.set_blocking(wake, False)
    for number in numbers:
        signal.signal(number, lambda *_: None)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    threading.Thread(target=_end_when_told, args=(arrived, numbers), daemon=True).start()


def _end_when_told(arrived: int, numbers: list[signal.Signals]) -> None:
    while (number := os.read(arrived, 1)[0]) not in numbers:
        pass
    _ENDING.set()
    word = "interrupted" if number == signal.SIGINT else "terminated"
    with contextlib.suppress(OSError):  # nobody may read
        os.write(2, f"\nkeycld: {word}; the same command continues.\n".encode())
    discard_partial()
    os._exit(128 + number)


def say(sentence: str) -> None:
    """Print a sentence on the standard error, on one line and without control characters that a file may hold."""
    if not _ENDING.is_set():
        line = " ".join(sentence.split())
        print("".join(c if c.isprintable() else "�" for c in line), file=sys.stderr)


def unforeseen(error: Exception, *, debug: bool) -> str:
    """Return a sentence about an error that nothing foresaw; the traceback goes to a file, with `debug` to stderr."""
    told = "".join(traceback.format_exception(error))
    if debug:
        print(told, file=sys.stderr)
    try:
        with tempfile.NamedTemporaryFile("w", prefix="keycld-", suffix=".log", delete=False, encoding="utf-8") as log:
            log.write(told)
        where = f"{log.name} says where"
    except OSError:
        where = "--debug shows where"
    first = (str(error).strip().splitlines() or ["no message"])[0][:200]
    return (
        f"{type(error).__name__} ({first}), which keycld did not foresee: a file is damaged, or this is a fault of "
        f"keycld; {where}."
    )
