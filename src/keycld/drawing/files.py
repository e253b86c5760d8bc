"""Write pictures, figures and movies, each file as a whole, and read pictures."""

import io
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import imageio.v3
import numpy as np
from jaxtyping import Shaped, UInt8
from PIL import Image, UnidentifiedImageError

from keycld._errors import KeycldError
from keycld._ffmpeg import FfmpegError, ffmpeg
from keycld._files import read_bytes, replacing, writing_error
from keycld.drawing.frames import as_uint8, enlarge

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Of a frame of a movie, after enlargement.
_LONGEST_SIDE = 8192
# Of a picture to read: 64 MB of pixels.
_MOST_PIXELS = 2**24


def save_image(path: str | Path, frame: Shaped[np.ndarray, "H W 3"]) -> None:
    """Write one frame, uint8 or float in [0, 1], in the format of the suffix (.png)."""
    with replacing(path) as temporary:
        imageio.v3.imwrite(temporary, as_uint8(frame))


def load_image(source: Path | bytes) -> UInt8[np.ndarray, "H W 3"]:
    """Read a PNG or JPEG picture from a file or from its contents; its claimed size is checked before its pixels are.

    Raises:
        FileNotFoundError: there is no such file.
        KeycldError: it is no such picture, or is larger than 16 million pixels.
    """
    what = "the picture" if isinstance(source, bytes) else f"the picture {source}"
    contents = source if isinstance(source, bytes) else read_bytes(source)
    try:
        with Image.open(io.BytesIO(contents), formats=("PNG", "JPEG")) as picture:
            if picture.width * picture.height <= _MOST_PIXELS:
                return np.asarray(picture.convert("RGB"))
            size = f"{picture.width} × {picture.height}"
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        # Pillow's own words for this name an object of Python's.
        reason = "it is no PNG or JPEG" if isinstance(error, UnidentifiedImageError) else error
        raise KeycldError(f"{what} cannot be read ({reason}): save it again as PNG.") from error
    raise KeycldError(f"{what} has {size} pixels, more than {_MOST_PIXELS:,}: make it smaller.")


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
    height, width = frames[0].shape[:2]
    if scale < 1 or scale * max(height, width) > _LONGEST_SIDE:
        raise KeycldError(
            f"frames of {width} × {height} pixels enlarged {scale} times are not between 1 and {_LONGEST_SIDE} pixels "
            "on a side: choose another scale."
        )
    height, width, _ = _even(enlarge(frames[0], scale)).shape
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-framerate", f"{fps:.6f}", "-i", "-"]
    with replacing(path) as temporary:
        options = _GIF if suffix == ".gif" else _MP4
        try:
            with ffmpeg("-v", "error", *source, *options, f"file:{temporary}", source=subprocess.PIPE) as process:
                for frame in frames:
                    process.write(np.ascontiguousarray(_even(enlarge(frame, scale))).data)
        except FfmpegError as error:
            raise writing_error(Path(path), OSError(str(error))) from error


# One palette for the whole movie: one for each frame flickers, a standard one has too few of the right colours.
_GIF = (
    "-filter_complex", "split[a][b];[a]palettegen=stats_mode=full[p];[b][p]paletteuse=dither=none",
    "-c:v", "gif", "-pix_fmt", "pal8",
)  # fmt: skip
# crf 18 is visually lossless; faststart lets a browser play before the file is complete.
_MP4 = ("-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-preset", "medium", "-movflags", "+faststart")


def _even(frame: np.ndarray) -> np.ndarray:
    """Repeat the last row or column where the size is odd: yuv420p halves it."""
    height, width, _ = frame.shape
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def save_figure(path: str | Path, figure: "Figure", dpi: float = 160.0) -> None:
    """Write a matplotlib figure in the format of the suffix (.png, .svg, .pdf)."""
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=dpi)
