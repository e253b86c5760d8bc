"""Runs ffmpeg on one local file: its exit status counts, it opens nothing else, and it cannot hang."""

import contextlib
import re
import signal
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO

# Seconds without a byte, after which ffmpeg is ended.
_SILENT = 60.0
# A picture of 8K: ffmpeg needs memory for a dozen of them.
_MOST_PIXELS = 8192 * 4608
# Containers of one video. Playlists, patterns of names and descriptions of networks would open other files.
_FORMATS = "mov,mp4,matroska,webm,avi,mpegts,mpeg,mpegvideo,m4v,flv,asf,gif,ogg,nut,mxf,dv,h264,hevc,ivf,apng,3gp"


def input_options(path: Path) -> list[str]:
    """Return the options that make ffmpeg read one video file and nothing else; those of the input come before."""
    limits = ["-protocol_whitelist", "file,pipe", "-format_whitelist", _FORMATS, "-max_pixels", str(_MOST_PIXELS)]
    return [*limits, "-threads", "2", "-i", f"file:{path}"]


@contextlib.contextmanager
def ffmpeg(*arguments: str, source: IO[bytes] | int = subprocess.DEVNULL) -> "Iterator[Process]":
    """Run ffmpeg while the body reads its output or writes its input.

    Raises:
        FfmpegError: it ended with an error, or did nothing for a minute.
    """
    import imageio_ffmpeg

    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-hide_banner", "-nostdin", "-y", *arguments]
    # In a group of its own an interrupt at the keyboard reaches this process alone, which then ends ffmpeg.
    child = subprocess.Popen(
        command, stdin=source, stdout=subprocess.PIPE, stderr=subprocess.PIPE, process_group=0, bufsize=0
    )
    process = Process(child)
    try:
        yield process
        process.finish()
    finally:
        process.end()


class FfmpegError(Exception):
    """What ffmpeg said before it failed."""


class Process:
    """A running ffmpeg."""

    def __init__(self, child: subprocess.Popen[bytes]):
        """Collect what it says, and watch that it does not stop."""
        self._child, self._said, self._silent = child, bytearray(), False
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        assert self._child.stderr is not None
        while part := self._child.stderr.read(4096):
            # The first lines describe the input, the last one says what is wrong.
            self._said += part
            del self._said[8192:-8192]

    @property
    def said(self) -> str:
        """What it has written to its standard error; complete after its end."""
        return self._said.decode(errors="replace")

    @contextlib.contextmanager
    def _watched(self) -> Iterator[None]:
        timer = threading.Timer(_SILENT, self._stop)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()

    def _stop(self) -> None:
        self._silent = True
        self._child.kill()

    def read(self, size: int) -> bytes:
        """Return the next bytes of its output; fewer at the end."""
        assert self._child.stdout is not None
        found = bytearray()
        while len(found) < size:
            with self._watched():
                part = self._child.stdout.read(size - len(found))
            if not part:
                break
            found += part
        return bytes(found)

    def write(self, contents: bytes | memoryview) -> None:
        """Pass bytes to its input."""
        assert self._child.stdin is not None
        view = memoryview(contents).cast("B")
        try:
            while view:
                with self._watched():
                    view = view[self._child.stdin.write(view) :]
        except BrokenPipeError:
            self.finish()

    def finish(self) -> None:
        """Close its input, and wait for its end.

        Raises:
            FfmpegError: it failed.
        """
        if self._child.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._child.stdin.close()
        with self._watched():
            code = self._child.wait()
        self._listener.join()
        if self._silent:
            raise FfmpegError(f"no progress in {_SILENT:.0f} s")
        if code != 0:
            lines = self.said.strip().splitlines()
            # The encoder's last line may only say that it stops; the reason is in one above.
            reasons = [line for line in lines if "No space left" in line or "File too large" in line]
            # The kernel ends who writes more than this account may.
            last = "File too large" if code == -signal.SIGXFSZ else f"code {code}"
            raise FfmpegError((reasons or lines or [last])[-1].strip())

    def end(self) -> None:
        """End it at once, if it still runs."""
        self._child.kill()
        self._child.wait()
        self._listener.join()
        for pipe in (self._child.stdin, self._child.stdout, self._child.stderr):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()


def described(said: str) -> float:
    """Return the seconds that ffmpeg says its input lasts; 0 if it does not."""
    found = re.search(r"Duration: (\d+):(\d+):([\d.]+)", said)
    return int(found[1]) * 3600 + int(found[2]) * 60 + float(found[3]) if found else 0.0
