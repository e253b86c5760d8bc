"""Write pictures and movies so that a reader sees the old file or the new one, never half of one."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import imageio.v2
import imageio.v3
import numpy as np
from jaxtyping import Shaped, UInt8
from matplotlib.figure import Figure

from keycld._errors import KeycldError
from keycld.drawing.frames import as_uint8, enlarge


@contextlib.contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; what was written there replaces `path` at the end.

    The folder is made where it is missing. If the body fails, `path` is left as it was.

    Raises:
        KeycldError: the folder cannot be made or written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except (PermissionError, NotADirectoryError, FileExistsError) as error:
        raise KeycldError(
            f"cannot write '{path}': {error.strerror or error}; choose a folder that you may write to."
        ) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def save_image(path: str | Path, frame: Shaped[np.ndarray, "H W 3"]) -> None:
    """Write one frame, uint8 or float in [0, 1], in the format that the suffix names (.png)."""
    with replacing(path) as temporary:
        imageio.v3.imwrite(temporary, as_uint8(frame))


def save_movie(path: str | Path, frames: UInt8[np.ndarray, "T H W 3"], fps: float | int = 25, scale: int = 4) -> None:
    """Write a movie, each pixel enlarged to a block of `scale` × `scale`.

    Args:
        path: `.mp4` gives H.264 in yuv420p, which every browser plays; `.gif` loops for ever.
        frames: uint8.
        fps: frames a second. GIF counts in hundredths of a second, at most 50 a second.
        scale: enlargement, nearest neighbour. 4 suits 64 × 64.

    Raises:
        KeycldError: the suffix is neither of the two, or there is no frame.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".mp4", ".gif"):
        raise KeycldError(f"a movie ends in .mp4 or .gif, not in '{suffix}' ('{path}').")
    if len(frames) == 0:
        raise KeycldError(f"a movie needs at least one frame; '{path}' got none.")
    with replacing(path) as temporary:
        if suffix == ".gif":
            hundredths = max(2, round(100.0 / fps))
            imageio.v3.imwrite(temporary, enlarge(frames, scale), duration=10 * hundredths, loop=0)
        else:
            _write_mp4(temporary, frames, fps, scale)


def _write_mp4(path: Path, frames: np.ndarray, fps: float, scale: int) -> None:
    writer = imageio.v2.get_writer(
        path,
        format="FFMPEG",  # pyright: ignore[reportArgumentType]
        fps=fps,
        codec="libx264",
        pixelformat="yuv420p",
        quality=None,
        macro_block_size=1,
        ffmpeg_log_level="error",
        # crf 18 is visually lossless; faststart lets a browser play before all is read.
        output_params=["-crf", "18", "-preset", "medium", "-movflags", "+faststart"],
    )
    with writer:
        for frame in frames:
            writer.append_data(_even(enlarge(frame, scale)))


def _even(frame: np.ndarray) -> np.ndarray:
    """Repeat the last row or column where yuv420p needs an even size."""
    height, width, _ = frame.shape
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def save_figure(path: str | Path, figure: Figure, dpi: float = 160.0) -> None:
    """Write a matplotlib figure in the format that the suffix names (.png, .svg, .pdf)."""
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=dpi)
