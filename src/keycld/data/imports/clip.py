"""One video of one motion becomes a data set: crop to what moves, split in time."""

import math
import time
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from keycld._errors import KeycldError
from keycld._ffmpeg import FfmpegError, ffmpeg, input_options
from keycld._files import make_folder
from keycld.data.imports.video import constraints_text, decode, origin, probe, spool_in, store, unreadable

_FEWEST, _MOST = 60, 1200
"""Frames of a video; of longer ones every second, third, … frame is kept."""
_LOOKED, _SIDE = 300, 160
"""Frames and pixels of the shorter side in which motion is looked for."""
_TRAIN, _TEST = 0.6, 1 / 3
"""Shares of the frames: the first ones for training, the last ones for the test."""


class ImportedClip(NamedTuple):
    """What was made of a video.

    Attributes:
        folder: the data set.
        crop: left, top, width and height of the part that is kept, pixels of the video.
        fps: frames a second of the recordings, in the time of the camera.
        frames: of training, validation and test.
    """

    folder: Path
    crop: tuple[int, int, int, int]
    fps: float
    frames: tuple[int, int, int]


def import_clip(
    path: str | Path,
    out: str | Path,
    *,
    constraints: str | Path,
    size: int = 64,
    fps: float | None = None,
    crop: tuple[int, int, int, int] | None = None,
    longest: int = 400,
) -> ImportedClip:
    """Make a data set of one video of one motion, of 60 frames to some minutes.

    The first three fifths of the frames are for training, the last third for the test, those between for validation.
    Each part is one recording, or several of equal length after one another. All frames are kept up to 1200, of longer
    videos every second, third, … one.

    Args:
        path: a video, any format that ffmpeg reads.
        out: the folder to make.
        constraints: a TOML file of keypoints and constraints, or the name of a mechanism.
        size: pixels of a side of the pictures, a multiple of 8.
        fps: frames a second with which the camera recorded, where the file states another rate (slow motion).
        crop: (left, top, width, height), a square in pixels of the video; by default the part in which something moves.
        longest: the most frames of a recording.

    Raises:
        KeycldError: no such file, not a video, too short, nothing moves, the camera moves, a cut, a bad crop or rate.
    """
    began, path, out = time.monotonic(), Path(path), Path(out)
    text = constraints_text(constraints)
    if not path.is_file():
        raise KeycldError(f"there is no video {path}: check the path.")
    if fps is not None and not 0 < fps < float("inf"):
        raise KeycldError(f"fps must be above 0, not {fps}.")
    width, height, own, seconds = probe(path)
    grey = _grey(path, width, height, own, seconds)
    if len(grey) < _FEWEST:
        raise KeycldError(f"{path} has {len(grey)} frames, but {_FEWEST} are the least: record a longer video.")
    _refuse_cuts(grey, path)
    part = _moving_part(grey, path)
    chosen = _square_around(part, width, height) if crop is None else crop
    every = max(1, math.ceil(seconds * own / _MOST))
    make_folder(out.parent)
    with spool_in(out.parent) as spool:
        total, kept = decode(path, spool, size, None if every == 1 else float(own / every), chosen, 0.0, 1)
        rate = kept if fps is None else fps / every
        images = np.memmap(spool, np.uint8, "r", shape=(total, size, size, 3))
        first, last = round(_TRAIN * total), total - round(_TEST * total)
        bounds = {"train": (0, first), "validation": (first, last), "test": (last, total)}
        parts = {name: _recordings(images[a:b], longest) for name, (a, b) in bounds.items()}
        attributes = origin([path], rate) | {"crop": chosen, "kept_fps": kept}
        store(out, parts, attributes, text, began)
    return ImportedClip(out, chosen, rate, (first, last - first, total - last))


def _recordings(images: np.ndarray, longest: int) -> np.ndarray:
    """Return frames `[T, …]` as recordings `[N, T // N, …]`, N as small as the longest recording allows."""
    count = math.ceil(len(images) / longest)
    length = len(images) // count
    return images[: count * length].reshape(count, length, *images.shape[1:])


def _grey(path: Path, width: int, height: int, rate: Fraction, seconds: float) -> UInt8[np.ndarray, "T h w"]:
    """Return at least 60 and about 300 frames of the whole video, grey and small, if it has as many."""
    scale = min(1.0, _SIDE / min(width, height))
    w, h = max(2, round(width * scale)), max(2, round(height * scale))
    every = max(1, math.floor(seconds * rate / _LOOKED))
    filters = f"fps={rate / every},scale={w}:{h}:flags=area"
    found = []
    try:
        with ffmpeg(
            "-v", "error", *input_options(path), "-vf", filters, "-pix_fmt", "gray", "-f", "rawvideo", "-"
        ) as process:
            while len(picture := process.read(w * h)) == w * h and len(found) < 4 * _LOOKED:
                found.append(np.frombuffer(picture, np.uint8).reshape(h, w))
            while process.read(2**20):
                pass
    except FfmpegError as error:
        raise unreadable(path, error) from error
    return np.array(found).reshape(-1, h, w)


def _refuse_cuts(grey: UInt8[np.ndarray, "T h w"], path: Path) -> None:
    """Refuse a video with a cut: one step changes the picture many times more than all others."""
    change = np.array([np.mean(np.abs(b.astype(float) - a)) for a, b in zip(grey[:-1], grey[1:], strict=True)])
    largest = int(np.argmax(change))
    if change[largest] > max(10.0, 8 * np.percentile(change, 95)):
        raise KeycldError(
            f"{path} has a cut at {100 * (largest + 1) / len(grey):.0f} % of its length: keep the part before or after "
            "it."
        )


def _moving_part(grey: UInt8[np.ndarray, "T h w"], path: Path) -> tuple[float, float, float, float]:
    """Return left, top, right and bottom of what moves, as shares of width and height.

    A pixel moves if it differs from its median over time by several times the noise in some of the frames.
    """
    off = np.abs(grey.astype(np.int16) - np.median(grey, axis=0).astype(np.int16)[None])
    noise = float(np.median(np.std(np.diff(grey[: min(60, len(grey))].astype(float), axis=0), axis=0))) / math.sqrt(2)
    differs = off > max(12.0, min(6 * noise, 20.0))
    if np.median(np.mean(differs, axis=(1, 2))) > 0.4:
        raise KeycldError(
            f"the whole picture moves in {path}: record it with a still camera in front of a still ground."
        )
    moves = np.mean(differs, axis=0) > 0.01
    padded = np.pad(moves.astype(int), 1)
    around = sum(padded[i : i + moves.shape[0], j : j + moves.shape[1]] for i in range(3) for j in range(3))
    moves &= around >= 4
    if np.mean(moves) < 5e-4:
        raise KeycldError(f"nothing moves in {path}: choose a video of a mechanism in motion.")
    rows, columns = np.nonzero(moves)
    (top, bottom), (left, right) = (np.percentile(index, [0.5, 99.5]) for index in (rows, columns))
    h, w = moves.shape
    return left / w, top / h, (right + 1) / w, (bottom + 1) / h


def _square_around(
    part: tuple[float, float, float, float], width: int, height: int, margin: float = 0.15
) -> tuple[int, int, int, int]:
    """Return left, top, width and height of the square around a part, with a margin, inside of the picture."""
    left, top, right, bottom = part[0] * width, part[1] * height, part[2] * width, part[3] * height
    side = min(width, height, round((1 + 2 * margin) * max(right - left, bottom - top)))
    side = max(8, side)
    x, y = round((left + right - side) / 2), round((top + bottom - side) / 2)
    return min(max(x, 0), width - side), min(max(y, 0), height - side), side, side
