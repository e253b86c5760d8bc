"""Write pictures, figures and movies; each file is replaced as a whole."""

import contextlib
from pathlib import Path
from typing import Any

import imageio.v3
import imageio_ffmpeg
import numpy as np
from jaxtyping import Shaped, UInt8
from matplotlib.figure import Figure

from keycld._errors import KeycldError
from keycld._files import replacing
from keycld.drawing.frames import as_uint8, enlarge


def save_image(path: str | Path, frame: Shaped[np.ndarray, "H W 3"]) -> None:
    """Write one frame, uint8 or float in [0, 1], in the format of the suffix (.png)."""
    with replacing(path) as temporary:
        imageio.v3.imwrite(temporary, as_uint8(frame))


def save_movie(path: str | Path, frames: UInt8[np.ndarray, "T H W 3"], fps: float | int = 25, scale: int = 4) -> None:
    """Write a movie, each pixel enlarged to a block of `scale` × `scale`.

    Args:
        path: `.mp4` gives H.264 in yuv420p, which browsers play; `.gif` loops forever.
        frames: uint8.
        fps: frames a second. A GIF stores hundredths of a second; browsers play above 50 too slowly.
        scale: enlargement, nearest neighbour. 4 suits 64 × 64.

    Raises:
        KeycldError: another suffix, no frame, or a path that cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".mp4", ".gif"):
        raise KeycldError(f"a movie ends in .mp4 or .gif, not in '{suffix}' ('{path}').")
    if len(frames) == 0:
        raise KeycldError(f"a movie needs at least one frame; '{path}' got none.")
    common: dict[str, Any] = {"fps": fps, "quality": None, "macro_block_size": 1, "ffmpeg_log_level": "error"}
    large = _even(enlarge(frames[0], scale)).shape
    with replacing(path) as temporary:
        writer = imageio_ffmpeg.write_frames(
            temporary,
            (large[1], large[0]),
            **common,
            **(_GIF if suffix == ".gif" else _MP4),
        )
        with contextlib.closing(writer):
            writer.send(None)
            for frame in frames:
                writer.send(np.ascontiguousarray(_even(enlarge(frame, scale))))


# One palette for the whole movie: one for each frame flickers, a standard one has too few of the right colours.
_GIF: dict[str, Any] = {
    "codec": "gif",
    "pix_fmt_out": "pal8",
    "output_params": [
        "-filter_complex",
        "split[a][b];[a]palettegen=stats_mode=full[p];[b][p]paletteuse=dither=none",
    ],
}
# crf 18 is visually lossless; faststart lets a browser play before the file is complete.
_MP4: dict[str, Any] = {
    "codec": "libx264",
    "pix_fmt_out": "yuv420p",
    "output_params": ["-crf", "18", "-preset", "medium", "-movflags", "+faststart"],
}


def _even(frame: np.ndarray) -> np.ndarray:
    """Repeat the last row or column where the size is odd: yuv420p halves it."""
    height, width, _ = frame.shape
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def save_figure(path: str | Path, figure: Figure, dpi: float = 160.0) -> None:
    """Write a matplotlib figure in the format of the suffix (.png, .svg, .pdf)."""
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=dpi)
