"""A page on this machine that shows pictures as they are made."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import imageio.v3
import numpy as np
from jaxtyping import UInt8

from keycld._errors import KeycldError

_PAGE = b"""<!doctype html>
<html lang="en"><meta charset="utf-8"><title>keycld watch --live</title>
<body><h1>What moves, and where it will be</h1>
<p>Rings: the keypoints now. Dots: the predicted ones, smaller and fainter the later.</p>
<img src="pictures" alt="the camera's picture with keypoints and their predicted paths" width="512" height="512">
</body></html>
"""
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; img-src 'self'",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
_NEXT = b"next"


class LivePage:
    """The newest picture, for any number of browsers; each gets the ones that it has time for.

    Attributes:
        address: of the page. Only this machine reaches it.
    """

    def __init__(self, server: ThreadingHTTPServer, news: threading.Condition):
        """Take the server, and what wakes those who wait for a picture."""
        self._news, self._number, self._picture, self._ended = news, 0, b"", False
        self.address = f"http://127.0.0.1:{server.server_address[1]}/"

    def show(self, frame: UInt8[np.ndarray, "H W 3"]) -> None:
        """Show a picture until the next one."""
        picture = imageio.v3.imwrite("<bytes>", frame, extension=".jpg")
        with self._news:
            self._picture, self._number = picture, self._number + 1
            self._news.notify_all()

    def end(self) -> None:
        """Let the browsers keep the last picture."""
        with self._news:
            self._ended = True
            self._news.notify_all()

    def pictures(self) -> Iterator[bytes]:
        """Yield the newest JPEG picture, then each time a newer one, to the end."""
        shown = 0
        while True:
            with self._news:
                while self._number == shown and not self._ended:
                    self._news.wait()
                if self._number == shown:
                    return
                shown, picture = self._number, self._picture
            yield picture


@contextmanager
def live_page(port: int) -> Iterator[LivePage]:
    """Serve a page while the body shows pictures on it.

    Args:
        port: of this machine; 0: a free one.

    Raises:
        KeycldError: the port is taken.
    """
    pages: list[LivePage] = []
    try:
        server = ThreadingHTTPServer(("127.0.0.1", port), partial(_Handler, pages))
    except (OSError, OverflowError) as error:
        raise KeycldError(
            f"port {port} cannot be used ({error}): choose another --port, or 0 for a free one."
        ) from error
    server.daemon_threads = True
    pages.append(LivePage(server, threading.Condition()))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield pages[0]
    finally:
        pages[0].end()
        server.shutdown()
        server.server_close()
        thread.join()


class _Handler(BaseHTTPRequestHandler):
    """Answers a browser: the page, and pictures that replace one another."""

    def __init__(self, pages: list[LivePage], *arguments):
        self._pages = pages
        super().__init__(*arguments)

    def do_GET(self) -> None:  # noqa: N802
        """Answer one request."""
        if self.path == "/":
            self._head(200, "text/html; charset=utf-8")
            self.wfile.write(_PAGE)
        elif self.path == "/pictures":
            self._head(200, f"multipart/x-mixed-replace; boundary={_NEXT.decode()}")
            try:
                for picture in self._pages[0].pictures():
                    size = str(len(picture)).encode()
                    head = b"--" + _NEXT + b"\r\nContent-Type: image/jpeg\r\nContent-Length: " + size + b"\r\n\r\n"
                    self.wfile.write(head + picture + b"\r\n")
            except ConnectionError:
                # The browser was closed.
                return
        else:
            self._head(404, "text/plain")

    def _head(self, code: int, kind: str) -> None:
        self.send_response(code)
        for name, value in {"Content-Type": kind, **_HEADERS}.items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, format: str, *arguments) -> None:
        """Say nothing of requests."""
