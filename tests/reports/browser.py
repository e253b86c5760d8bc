"""Open a page in headless Chromium and return what is on it."""

import base64
import hashlib
import html
import json
import re
import shutil
import subprocess
from pathlib import Path

# Runs in a copy of the page, waits for every movie and picture, and leaves what it finds in an attribute.
_LOOK = """
<script>
const errors = [], refused = [];
addEventListener("error", event => { if (event.message) errors.push(event.message); });
addEventListener("securitypolicyviolation", event => refused.push(event.blockedURI));
addEventListener("load", async () => {
  const movies = [...document.querySelectorAll("video")], pictures = [...document.querySelectorAll("img")];
  const ready = movie => new Promise(done => {
    if (movie.readyState >= 2 || movie.networkState === HTMLMediaElement.NETWORK_NO_SOURCE) return done();
    for (const name of ["loadeddata", "error"]) movie.addEventListener(name, done, true);
  });
  await Promise.all([...movies.map(ready), ...pictures.map(picture => picture.decode().catch(() => 0))]);
  const instead = document.querySelector("img.instead");
  const wide = [...document.querySelectorAll("main *")].filter(
    part => !part.closest(".scroll, pre, svg") && part.getBoundingClientRect().right > innerWidth + 1);
  document.documentElement.dataset.seen = JSON.stringify({
    movies: movies.map(movie => [movie.videoWidth, movie.duration]),
    pictures: pictures.map(picture => picture.naturalWidth),
    requests: performance.getEntriesByType("resource").map(e => e.name).filter(name => !name.startsWith("data:")),
    refused, errors,
    wider_than_window: wide.map(part => part.tagName + "." + part.className),
    movie_hidden: movies.length > 0 && movies[0].hidden,
    gif_width: instead && !instead.hidden ? instead.getBoundingClientRect().width : 0,
  });
});
</script>
"""


def look(page: Path, folder: Path) -> dict:
    """Return what Chromium finds on the page; its own messages are among the `errors`."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    assert browser, "this test opens the report in Chromium, which is missing: `make test` installs it"
    copy = folder / "copy.html"
    # The page allows no script but its own: the copy allows this one too.
    allowed = hashlib.sha256(_LOOK.strip().removeprefix("<script>").removesuffix("</script>").encode()).digest()
    text = page.read_text().replace("script-src ", f"script-src 'sha256-{base64.b64encode(allowed).decode()}' ", 1)
    copy.write_text(text.replace("<main>", _LOOK + "<main>", 1))
    switches = [
        "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        "--enable-logging=stderr", "--window-size=800,900", "--virtual-time-budget=20000",
        f"--user-data-dir={folder / 'profile'}", "--dump-dom",
    ]  # fmt: skip
    # On a loaded machine the browser's virtual time can run out before its decoder has answered: look again.
    for _ in range(3):
        answer = subprocess.run(
            [browser, *switches, copy.as_uri()], capture_output=True, text=True, timeout=120, check=True
        )
        found = re.search(r'data-seen="([^"]*)"', answer.stdout)
        if found:
            break
    assert found, f"the page did not finish: {answer.stderr[-2000:]}"
    seen = json.loads(html.unescape(found.group(1)))
    seen["errors"] += [line for line in answer.stderr.splitlines() if ":CONSOLE" in line]
    return seen
