"""The frame of a page: style, the rule that nothing comes from elsewhere, and what moves."""

from importlib import resources
from pathlib import Path

from keycld._files import write_text
from keycld.reports import html

# The browser itself refuses everything that is not in the file.
_POLICY = "default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"

# Stops and starts a movie on a click, respects a wish for less motion, shows the GIF where H.264 is unknown.
_SCRIPT = """
const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
for (const video of document.querySelectorAll("video")) {
  if (calm) { video.removeAttribute("autoplay"); video.pause(); }
  video.addEventListener("click", () => video.paused ? video.play() : video.pause());
  const instead = video.nextElementSibling;
  const swap = () => {
    if (instead && instead.classList.contains("instead")) { video.hidden = true; instead.hidden = false; }
  };
  // The browser may have given up before this line is reached.
  if (video.networkState === HTMLMediaElement.NETWORK_NO_SOURCE) swap();
  video.querySelector("source").addEventListener("error", swap);
}
"""


def write_page(path: Path, title: str, body: str, footer: str) -> Path:
    """Write one HTML file that opens in any browser and asks the network for nothing; returns its path.

    Args:
        path: of the page.
        title: of the browser's window.
        body: HTML.
        footer: HTML, what wrote the page and from what.

    Raises:
        KeycldError: it cannot be written.
    """
    style = resources.files("keycld.reports").joinpath("style.css").read_text()
    page = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark"><link rel="icon" href="data:,">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        f"<title>{html.text(title)}</title><style>{style}</style></head>"
        f"<body><main>{body}</main><footer>{footer}</footer><script>{_SCRIPT}</script></body></html>\n"
    )
    write_text(path, page)
    return path
