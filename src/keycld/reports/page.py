"""The document of a page: style, script, and a policy that forbids requests."""

import base64
import hashlib
from importlib import resources
from pathlib import Path

from keycld._files import write_text
from keycld.reports import html

# The browser refuses everything that is not in the file, and every style and script but the page's own.
_POLICY = (
    "default-src 'none'; img-src data:; media-src data:; script-src {script}; style-src-elem {style}; "
    "style-src-attr 'unsafe-inline'; base-uri 'none'; form-action 'none'"
)

# A click pauses or plays a movie; movies do not play if the reader prefers less motion; the GIF replaces a movie
# that the browser cannot play.
_SCRIPT = """
const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
for (const video of document.querySelectorAll("video")) {
  if (calm) { video.removeAttribute("autoplay"); video.pause(); }
  video.addEventListener("click", () => video.paused ? video.play() : video.pause());
  const instead = video.nextElementSibling;
  const swap = () => {
    if (instead && instead.classList.contains("instead")) { video.hidden = true; instead.hidden = false; }
  };
  // The browser may have refused the movie before this line runs.
  if (video.networkState === HTMLMediaElement.NETWORK_NO_SOURCE) swap();
  video.querySelector("source").addEventListener("error", swap);
}
"""


def write_page(path: Path, title: str, body: str, footer: str) -> Path:
    """Write one HTML file that needs no other file and no network; return its path.

    Args:
        path: file to write.
        title: title of the window.
        body: HTML.
        footer: HTML, the command that wrote the page and its sources.

    Raises:
        KeycldError: it cannot be written.
    """
    style = resources.files("keycld.reports").joinpath("style.css").read_text()
    policy = _POLICY.format(script=_hash(_SCRIPT), style=_hash(style))
    page = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark"><link rel="icon" href="data:,">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        f"<title>{html.text(title)}</title><style>{style}</style></head>"
        f"<body><main>{body}</main><footer>{footer}</footer><script>{_SCRIPT}</script></body></html>\n"
    )
    write_text(path, page)
    return path


def _hash(contents: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(contents.encode()).digest()).decode()}'"
