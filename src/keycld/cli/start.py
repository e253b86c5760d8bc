"""The installed command: how it begins, and how it ends when a signal or something unforeseen stops it."""

import gc
import sys
import tempfile
import threading
import traceback
from collections.abc import Sequence

from keycld._signals import ENDING, end_on_signals

# What these have done stays; all other verbs begin anew.
_RESUMED = (["demo"], ["data", "make"], ["watch"], ["train"], ["bench", "run"])


def entry() -> None:
    """Run the installed command `keycld`."""
    end_on_signals(then=after_an_end(sys.argv[1:]))
    # Tracing makes many small objects that stay: to look for garbage after every 700 takes a twentieth of its time.
    gc.set_threshold(50_000, 20, 20)
    from keycld.cli.main import main

    code = main()
    if ENDING.is_set():
        threading.Event().wait()  # the other thread ends the process
    sys.exit(code)


def after_an_end(words: Sequence[str]) -> str:
    """Return what to do after the command with these words was interrupted."""
    verb = [word for word in words if not word.startswith("-")]
    return "the same command continues" if any(verb[: len(each)] == each for each in _RESUMED) else "run it again"


def say(sentence: str) -> None:
    """Print a sentence on the standard error, on one line and without control characters that a file may hold."""
    if not ENDING.is_set():
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
