"""Movies of recordings."""

import math
from pathlib import Path

import numpy as np

from keycld._errors import KeycldError
from keycld.data.format.trajectories import Trajectories

# A GIF counts in hundredths of a second and browsers slow down anything faster than two of them.
_GIF_RATE = 50.0
PREVIEWED = 4


def show(trajectories: Trajectories, out: str | Path, *, trajectory: int = 0, scale: int = 4) -> Path:
    """Write the movie of one recording at its true speed; a GIF of fast pictures leaves some frames out.

    Args:
        trajectories: with pictures.
        out: a path that ends in .gif or .mp4.
        trajectory: number of the recording; negative ones count from the last.
        scale: each pixel becomes a block of `scale` × `scale`.

    Raises:
        KeycldError: no such recording, no pictures, or another ending.
    """
    from keycld.drawing import save_movie

    image = _images(trajectories)
    if not -len(image) <= trajectory < len(image):
        raise KeycldError(f"there is no recording {trajectory}: choose 0 to {len(image) - 1}.")
    out = Path(out)
    stride = _stride(trajectories.dt) if out.suffix.lower() == ".gif" else 1
    save_movie(out, image[trajectory, ::stride], fps=1.0 / (stride * trajectories.dt), scale=scale)
    return out


def write_preview(trajectories: Trajectories, path: Path) -> None:
    """Write a GIF of the first recordings, side by side."""
    from keycld.drawing import save_movie, side_by_side

    stride = _stride(trajectories.dt)
    panels = list(_images(trajectories)[:PREVIEWED, ::stride])
    save_movie(path, side_by_side(panels), fps=1.0 / (stride * trajectories.dt), scale=2)


def _images(trajectories: Trajectories) -> np.ndarray:
    if trajectories.image is None:
        raise KeycldError(
            "these recordings hold no pictures, and no renderer of keycld for their states: add '/image'."
        )
    return trajectories.image


def _stride(dt: float) -> int:
    return max(1, math.ceil(1.0 / (_GIF_RATE * dt) - 1e-9))
