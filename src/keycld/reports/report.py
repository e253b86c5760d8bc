"""The page of a run."""

from pathlib import Path

from keycld._lock import alone
from keycld.reports import clip_sections, control_section, html, physics_sections, prediction_sections, run_sections
from keycld.reports.page import write_page
from keycld.reports.run import Run, read_run

_SECTIONS = (
    prediction_sections.trajectories,
    prediction_sections.frame_sheets,
    prediction_sections.accuracy,
    prediction_sections.long_horizons,
    physics_sections.observation,
    physics_sections.keypoints,
    physics_sections.potential,
    physics_sections.conservation,
    physics_sections.masses,
    control_section.control,
    run_sections.training,
    run_sections.reproduction,
)
# What a training that failed has to show; the constants of a clip may have been measured without a model.
_OF_FAILURE = (
    run_sections.verdict,
    clip_sections.constants,
    clip_sections.rejected,
    clip_sections.alternatives,
    run_sections.training,
    run_sections.reproduction,
)
_CLIP_SECTIONS = (
    clip_sections.constants,
    clip_sections.prediction,
    clip_sections.course,
    clip_sections.rejected,
    clip_sections.alternatives,
    run_sections.training,
    run_sections.reproduction,
)


def write_report(run_folder: str | Path) -> Path:
    """Write `report.html` into a run folder, and its movies and figures into `media/`; return the path of the page.

    It reads stored results only: `config.json`, `environment.json`, `metrics.jsonl` and `evaluation/`. A line replaces
    each section whose results are missing. The page of a training that failed says why, and shows nothing as a model. A
    run that learned a clip has a page of its own.

    Raises:
        KeycldError: it is not a run folder, a stored file is damaged, or the folder cannot be written.
    """
    run = read_run(run_folder)
    with alone(Path(run_folder), "writes its report", ".report.lock"):
        return _write(run, Path(run_folder))


def _write(run: Run, folder: Path) -> Path:
    title = f"{run.name} · KeyCLD"
    if run.motion is None or run.failed:
        sections = "".join(section(run) for section in (_OF_FAILURE if run.failed else _SECTIONS))
        body = prediction_sections.head(run, sections) + sections
    else:
        sections = "".join(section(run) for section in _CLIP_SECTIONS)
        body = clip_sections.head(run) + html.contents(sections) + sections
    footer = "Written by <b>keycld report</b> from the results in this run’s folder."
    return write_page(folder / "report.html", title, body, footer)
