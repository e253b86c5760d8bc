"""One HTML page that shows a run: no other file, no network."""

from importlib import resources
from pathlib import Path

from keycld.drawing import replacing
from keycld.reports import html, physics_sections, prediction_sections, run_sections
from keycld.reports.run import read_run

_SECTIONS = (
    prediction_sections.trajectories,
    prediction_sections.frame_sheets,
    prediction_sections.accuracy,
    prediction_sections.long_horizons,
    physics_sections.keypoints,
    physics_sections.potential,
    physics_sections.conservation,
    physics_sections.masses,
    run_sections.training,
    run_sections.reproduction,
)

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


def write_report(run_folder: str | Path) -> Path:
    """Write `report.html` into a run folder, and its movies and figures into `media/`; returns the page's
    path.

    Reads stored results only: `config.json`, `environment.json`, `metrics.jsonl` and `evaluation/`. A
    section whose results are missing is replaced by one line that says so.

    Raises:
        KeycldError: it is not a run folder, a stored file is damaged, or the folder cannot be written.
    """
    run = read_run(run_folder)
    style = resources.files("keycld.reports").joinpath("style.css").read_text()
    title = f"{run.config.get('system', 'run')} · KeyCLD"
    body = prediction_sections.head(run) + "".join(section(run) for section in _SECTIONS)
    page = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark"><link rel="icon" href="data:,">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        f"<title>{html.text(title)}</title><style>{style}</style></head>"
        f"<body><main>{body}</main><footer>Written by <b>keycld report</b> from the results in this run’s "
        "folder."
        f"</footer><script>{_SCRIPT}</script></body></html>\n"
    )
    path = Path(run_folder) / "report.html"
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path
