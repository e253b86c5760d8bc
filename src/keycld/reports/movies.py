"""Movies and sheets of the trajectories that an evaluation stores."""

from pathlib import Path

import numpy as np

from keycld import benchmarks
from keycld.drawing import (
    enlarge,
    overlay_heat_maps,
    overlay_keypoints,
    overlay_timeline,
    save_image,
    save_movie,
    sheet,
    side_by_side,
)
from keycld.evaluation import Evaluation
from keycld.reports import html

_TRAIL = 10
# Stored frames from one picture of a sheet to the next, as in Fig. 4 of the paper.
_EVERY = 6


def frames_per_second(result: Evaluation) -> float:
    """Return the frame rate of the movies: real time, but at most 25 frames a second."""
    step = int(result.arrays["shown_index"][1] - result.arrays["shown_index"][0])
    real = 1.0 / (result.scores["dt"] * step)
    return min(25.0, real)


def speed(result: Evaluation) -> str:
    """Return how fast a movie plays, in words."""
    step = int(result.arrays["shown_index"][1] - result.arrays["shown_index"][0])
    factor = frames_per_second(result) * result.scores["dt"] * step
    return "in real time" if abs(factor - 1.0) < 0.01 else f"{1.0 / factor:.3g} times slower than real time"


def _panels(result: Evaluation, n: int, scale: int, *, wide: bool) -> np.ndarray:
    """Return frames with truth, heat maps of the truth (if `wide`) and prediction, and a bar that shows validity."""
    arrays = result.arrays
    truth, prediction = arrays["truth"][n], arrays["prediction"][n]
    panels = [enlarge(truth, scale)]
    if wide and "heat_maps" in arrays:
        panels.append(overlay_heat_maps(truth, arrays["heat_maps"][n], scale))
    if "keypoints" in arrays:
        keypoints = arrays["keypoints"][n, arrays["shown_index"]].astype(np.float64)
        panels.append(overlay_keypoints(prediction, keypoints, scale, trail=_TRAIL))
    else:
        panels.append(enlarge(prediction, scale))
    return overlay_timeline(side_by_side(panels), result.valid[n, arrays["shown_index"]], height=2 * scale)


def headline_movie(folder: Path, result: Evaluation) -> str:
    """Return the movie of the first trajectory: truth, heat maps, prediction.

    Writes media/prediction.mp4 and .gif.
    """
    frames = _panels(result, 0, 4, wide=True)
    path = folder / "media" / "prediction.mp4"
    save_movie(path, _held(frames), frames_per_second(result), scale=1)
    small = _panels(result, 0, 2, wide=True)
    gif = path.with_suffix(".gif")
    save_movie(gif, _held(small), frames_per_second(result), scale=1)
    return html.movie(path, frames[-1], gif, "Truth and prediction of the first recording, moving")


def trajectory_movies(folder: Path, result: Evaluation) -> list[str]:
    """Return a movie of each stored trajectory, truth next to prediction; writes media/NAME-N.mp4."""
    name = result.scores["protocol"]["name"]
    found = []
    for n in range(len(result.arrays["truth"])):
        frames = _panels(result, n, 4, wide=False)
        path = folder / "media" / f"{name}-{n + 1}.mp4"
        save_movie(path, _held(frames), frames_per_second(result), scale=1)
        found.append(html.movie(path, frames[-1], None, f"Truth and prediction of recording {n + 1}, moving"))
    return found


def _held(frames: np.ndarray) -> np.ndarray:
    """Return the frames with the last one repeated for half a second, so that the end of each loop is visible."""
    return np.concatenate([frames, np.repeat(frames[-1:], 12, axis=0)])


def sheet_step(shown: np.ndarray) -> int:
    """Return how many frames lie between two pictures of a sheet; `shown` are the numbers of the stored frames."""
    shown = shown[::_EVERY]
    return int(shown[1] - shown[0]) if len(shown) > 1 else _EVERY


def trajectory_sheet(folder: Path, result: Evaluation, n: int) -> str:
    """Return a sheet of every sixth stored frame, truth above prediction (Fig. 4); writes media/sheet-N.png."""
    rows = [result.arrays["truth"][n], result.arrays["prediction"][n]]
    picture = sheet(rows, _EVERY)
    save_image(folder / "media" / f"sheet-{n + 1}.png", enlarge(picture, 3))
    count = len(rows[0][::_EVERY])
    numbers = result.arrays["shown_index"][::_EVERY]
    heads = "".join(f"<span>{number}</span>" for number in numbers)
    image = html.image(
        picture,
        f"One frame in {sheet_step(result.arrays['shown_index'])} of recording {n + 1}: truth above, prediction below",
    )
    return (
        f'<div class="sheet" style="--frames:{count}">'
        '<div class="rows"><span>truth</span><span>prediction</span></div>'
        f'<div>{image}<div class="numbers">{heads}</div></div></div>'
    )


def observation_sheet(folder: Path, result: Evaluation, count: int = 4) -> str:
    """Show how a given frame becomes keypoints and a picture again (Fig. 1), one recording a row.

    Writes media/keypoints.png.
    """
    count = min(count, len(result.arrays["truth"]))
    picture = benchmarks.observation_sheet([(str(n + 1), result, n) for n in range(count)])
    path = folder / "media" / "keypoints.png"
    save_image(path, picture)
    width = f'style="max-width:{picture.shape[1]}px"'
    return f'<img {width} src="{html.data_uri(path)}" alt="Frames, heat maps, keypoints and the rendered pictures">'
