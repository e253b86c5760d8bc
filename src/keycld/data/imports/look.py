"""What a video shows: where something moves, from when to when, and why one cannot be learned from."""

import math
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8

from keycld._errors import KeycldError
from keycld._ffmpeg import FfmpegError, ffmpeg, input_options
from keycld.data.imports.exposure import made_alike
from keycld.data.imports.overlays import Box, overlays
from keycld.data.imports.plane import Plane, plane_filter
from keycld.data.imports.stretch import leaving, undisturbed
from keycld.data.imports.video import probe, refuse_other_sizes, span_options, unreadable

FEWEST = 60
"""Frames that a video, or the part of it that is used, has at least."""
LOOKED = 300
"""Frames in which motion is looked for."""
# Pixels of their shorter side.
_SIDE = 160
# Share of the frames in which a part may be out of the picture.
_OUT = 0.1


class Look(NamedTuple):
    """What a video shows.

    Attributes:
        path: of the video.
        width: of its pictures, pixels.
        height: of its pictures, pixels.
        rate: frames a second.
        span: from which second to which it is used; None: to its end.
        seconds: how many these are.
        part: where something moves.
        overlays: where something changes without moving, such as a clock.
        leaving: at which edges parts leave the picture, and in which share of the frames one is out of it.
    """

    path: Path
    width: int
    height: int
    rate: Fraction
    span: tuple[float, float | None]
    seconds: float
    part: Box
    overlays: list[Box]
    leaving: tuple[list[str], float]


def look_at(path: Path, plane: Plane | None, plane_ratio: float, named: tuple[float, float | None] | None) -> Look:
    """Read what a part of a video shows, and refuse one that shows no motion of a mechanism.

    The part is from one second to another, or None: the longest stretch that shows the mechanism alone and in motion.

    Raises:
        KeycldError: no such file, not a video, too short, nothing moves, the camera moves, a cut; a bad plane or
            ratio.
    """
    width, height, rate, whole = probe(path)
    skip, until = named or (0.0, None)
    seconds = max(0.0, min(whole, until or whole) - skip)
    if plane is None and plane_ratio != 1:
        raise KeycldError(f"--plane-ratio {plane_ratio:g} is the shape of a --plane: give its four corners too.")
    mapped = "" if plane is None else f"{plane_filter(plane, plane_ratio, width, height)},"
    every = max(1, math.floor(seconds * rate / LOOKED))
    grey, dt = _grey(path, width, height, rate / every, (skip, until), mapped), float(every / rate)
    if len(grey) < FEWEST:
        part = "" if named is None else " in this part"
        raise KeycldError(f"{path} has {len(grey)} frames{part}, but {FEWEST} are the least: record a longer video.")
    # Raw streams, whose length is not known, hold no times to skip to.
    chosen = named is None and whole > 0
    # A camera that is touched at the beginning or end changes the whole picture; this is left out below.
    edge = len(grey) // 10 if chosen else 0
    _refuse_cuts(grey[edge : len(grey) - edge], path, skip + edge * dt, dt)
    made_alike([grey[..., None]])
    differs = _differs(grey)
    part, overlays = _moving_part(differs, path)
    first, last = undisturbed(grey, differs, dt) if chosen else (0, len(grey))
    if last - first < min(FEWEST, len(grey)):
        raise KeycldError(
            f"the longest stretch of {path} that shows the mechanism alone and in motion has {last - first} frames, "
            f"but {FEWEST} are the least: record a longer one, or name the seconds to use with --from and --until."
        )
    if (first, last) != (0, len(grey)):
        skip, until = first * dt, None if last == len(grey) else last * dt
        differs = _differs(grey[first:last])
        part, overlays = _moving_part(differs, path)
    seconds = (last - first) * dt
    return Look(path, width, height, rate, (skip, until), seconds, part, overlays, leaving(differs))


def refuse_unlike(videos: Sequence[Look]) -> None:
    """Refuse videos of different sizes or rates."""
    refuse_other_sizes([video.path for video in videos], [(video.width, video.height) for video in videos])
    first = videos[0]
    for video in videos[1:]:
        if abs(video.rate - first.rate) > Fraction(1, 100):
            raise KeycldError(
                f"{video.path} has {float(video.rate):g} frames a second, {first.path} {float(first.rate):g}: give "
                "videos of one rate."
            )


def refuse_leaving(videos: Sequence[Look]) -> None:
    """Refuse a video in which a part is often out of the picture, where no keypoint can follow it."""
    for video in videos:
        edges, share = video.leaving
        if share > _OUT:
            raise KeycldError(
                f"a part is out of the picture, beyond its {' and '.join(edges)} edge, in {share:.0%} of the frames of "
                f"{video.path}: record it from farther away, or name the seconds in which all parts are seen with "
                "--from and --until, or the square to learn from with --crop."
            )


def _grey(
    path: Path,
    width: int,
    height: int,
    rate: Fraction,
    span: tuple[float, float | None],
    mapped: str,
) -> UInt8[np.ndarray, "T h w"]:
    """Return frames of a part of a video at this rate, grey and small."""
    scale = min(1.0, _SIDE / min(width, height))
    w, h = max(2, round(width * scale)), max(2, round(height * scale))
    filters = f"fps={rate},{mapped}scale={w}:{h}:flags=area"
    source = [*span_options(*span), *input_options(path)]
    found = []
    try:
        with ffmpeg("-v", "error", *source, "-vf", filters, "-pix_fmt", "gray", "-f", "rawvideo", "-") as process:
            while len(picture := process.read(w * h)) == w * h and len(found) < 4 * LOOKED:
                found.append(np.frombuffer(picture, np.uint8).reshape(h, w))
            while process.read(2**20):
                pass
    except FfmpegError as error:
        raise unreadable(path, error) from error
    return np.array(found).reshape(-1, h, w)


def _refuse_cuts(grey: UInt8[np.ndarray, "T h w"], path: Path, skip: float, dt: float) -> None:
    """Refuse a video with a cut: one step changes the picture many times more than all others.

    The first of these frames is at second `skip`, the others every `dt`.
    """
    change = np.array([np.mean(np.abs(b.astype(float) - a)) for a, b in zip(grey[:-1], grey[1:], strict=True)])
    largest = int(np.argmax(change))
    if change[largest] > max(10.0, 8 * np.percentile(change, 95)):
        raise KeycldError(
            f"{path} has a cut at {skip + (largest + 1) * dt:.2f} s: name the part before it with --until, or the part "
            "after it with --from."
        )


def _differs(grey: UInt8[np.ndarray, "T h w"]) -> Bool[np.ndarray, "T h w"]:
    """Return which pixels differ from their median over time by several times the noise."""
    off = np.abs(grey.astype(np.int16) - np.median(grey, axis=0).astype(np.int16)[None])
    noise = float(np.median(np.std(np.diff(grey[: min(60, len(grey))].astype(float), axis=0), axis=0))) / math.sqrt(2)
    return off > max(12.0, min(6 * noise, 20.0))


def _moving_part(differs: Bool[np.ndarray, "T h w"], path: Path) -> tuple[Box, list[Box]]:
    """Return where something moves, and where something changes without moving."""
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
    h, w = moves.shape
    still = overlays(differs, moves)
    for left, top, right, bottom in still:
        moves[round(top * h) : round(bottom * h), round(left * w) : round(right * w)] = False
    rows, columns = np.nonzero(moves)
    (top, bottom), (left, right) = (np.percentile(index, [0.5, 99.5]) for index in (rows, columns))
    return (left / w, top / h, (right + 1) / w, (bottom + 1) / h), still
