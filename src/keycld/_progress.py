"""Progress of long work: a bar on a terminal, plain lines elsewhere."""

import math
import sys
import time


class Bar:
    """A line with progress, speed and time left.

    On a terminal the line is updated at most ten times a second. Elsewhere a plain line is printed at the first call,
    every `every` seconds and at the end.
    """

    def __init__(self, name: str, total: int, *, every: float = 15.0, stream=None):
        self._name, self._total = name, total
        self._stream = sys.stderr if stream is None else stream
        self._live = self._stream.isatty()
        self._pause = 0.1 if self._live else every
        self._shown = -math.inf
        self._since: tuple[float, int] | None = None

    def show(self, done: int, unit_rate: float, text: str) -> None:
        """Update the line.

        Args:
            done: steps done of the total.
            unit_rate: frames a second.
            text: what follows on the line.
        """
        now = time.monotonic()
        # The first steps also compile, or were done by another process: the time left is estimated from later ones.
        if self._since is None:
            self._since = now, done
        last = done >= self._total
        if now - self._shown < self._pause and not last:
            return
        self._shown = now
        since, first = self._since
        left = ""
        if last or done > first:
            left = f"  {_clock((now - since) / max(done - first, 1) * (self._total - done))} left"
        filled = round(20 * done / max(self._total, 1))
        bar = "█" * filled + "·" * (20 - filled)
        line = f"{self._name:12s} {bar} {done}/{self._total}  {unit_rate:6.0f} frames/s{left}  {text}"
        if self._live:
            print("\r\x1b[2K" + line, end="\n" if last else "", file=self._stream, flush=True)
        else:
            print(line, file=self._stream, flush=True)


class Counted:
    """A `progress(done, total)` callback for frames that shows a bar; its time includes compilation."""

    def __init__(self, name: str):
        self._name, self._since = name, time.monotonic()
        self._bar: Bar | None = None

    def __call__(self, done: int, total: int) -> None:
        """Show that `done` of `total` frames are done."""
        if self._bar is None:
            self._bar = Bar(self._name, total)
        self._bar.show(done, done / max(time.monotonic() - self._since, 1e-9), "")


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
