"""Movies of recordings."""

from pathlib import Path

import numpy as np

from keycld._errors import KeycldError
from keycld.data.store import Trajectories
from keycld.drawing import save_movie, side_by_side

_PREVIEWED = 4


def _images(trajectories: Trajectories) -> np.ndarray:
    if trajectories.image is None:
        raise KeycldError("this file holds no pictures, only states: draw them first.")
    return trajectories.image


def show(trajectories: Trajectories, out: str | Path, *, trajectory: int = 0, scale: int = 4) -> Path:
    """Write the movie of one recording in its true speed, each pixel enlarged to `scale` × `scale`.

    Args:
        trajectories: with pictures.
        out: `.gif` (at most 50 frames a second) or `.mp4`.
        trajectory: number of the recording; negative ones count from the last.
        scale: enlargement.

    Raises:
        KeycldError: no such recording, no pictures, or another ending.
    """
    image = _images(trajectories)
    if not -len(image) <= trajectory < len(image):
        raise KeycldError(f"there is no recording {trajectory}: choose 0 to {len(image) - 1}.")
    out = Path(out)
    save_movie(out, image[trajectory], fps=1.0 / trajectories.dt, scale=scale)
    return out


def write_preview(trajectories: Trajectories, path: Path) -> None:
    """Write the first recordings side by side, one after another in time where there is only one."""
    image = _images(trajectories)[:_PREVIEWED]
    save_movie(path, side_by_side(list(image)), fps=1.0 / trajectories.dt, scale=2)
