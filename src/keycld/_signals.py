"""The end of a process at a signal."""

import contextlib
import os
import signal
import threading

from keycld._files import discard_partial

ENDING = threading.Event()
"""Set while a signal ends the process: nothing more is said."""


def end_on_signals(*, then: str = "") -> None:
    """End the process with code 130 at an interrupt and 143 at a termination, wherever it is.

    Everything on the disk survives a kill, so nothing need be unwound: an exception would have to pass through
    compiled code, which may crash or lose it. A thread of its own does not wait for long compilations either.

    Args:
        then: what to do next, with which a line says so; without it there is no line.
    """
    numbers = [each for each in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(each) is not signal.SIG_IGN]
    arrived, wake = os.pipe()
    os.set_blocking(wake, False)
    for number in numbers:
        signal.signal(number, lambda *_: None)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    threading.Thread(target=_end_when_told, args=(arrived, numbers, then), daemon=True).start()


def _end_when_told(arrived: int, numbers: list[signal.Signals], then: str) -> None:
    while (number := os.read(arrived, 1)[0]) not in numbers:
        pass
    ENDING.set()
    word = "interrupted" if number == signal.SIGINT else "terminated"
    if then:
        with contextlib.suppress(OSError):  # nobody may read
            os.write(2, f"\nkeycld: {word}; {then}.\n".encode())
    discard_partial()
    os._exit(128 + number)
