"""Imports videos."""

import contextlib
import math
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import IO, Any

import numpy as np

from keycld._errors import KeycldError
from keycld._ffmpeg import FfmpegError, described, ffmpeg, input_options
from keycld._files import make_folder, write_text, writing_error
from keycld._lock import alone
from keycld._progress import Counted
from keycld._version import __version__
from keycld.data.describe.finish import finish
from keycld.data.format.folder import CONSTRAINTS
from keycld.data.format.rules import LARGEST_RECORDING
from keycld.data.format.trajectories import Trajectories
from keycld.data.format.writing import write
from keycld.data.imports.claim import claim, refuse_used
from keycld.systems import names

SPLITS: tuple[str, ...] = ("train", "validation", "test")
# Letters of the names of videos in an attribute, which may have a thousand.
_LONGEST_NAMES = 500


def import_video(
    paths: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    size: int = 64,
    fps: float | None = None,
    crop: tuple[int, int, int, int] | None = None,
    skip: float = 0.0,
    until: float | None = None,
    frames: int = 50,
    validation: float = 0.1,
    test: float = 0.1,
    constraints: str | Path | None = None,
) -> Path:
    """Make a data set of one or more videos of the same system, recorded from the same place.

    Each video is cropped, scaled and cut into recordings of equal length, one after another; the remainder is dropped.
    The earliest recordings become the training split, the latest the test split, so that no test frame lies between
    training frames. There is no input and no true state.

    Args:
        paths: video files, any format that ffmpeg reads.
        out: the folder to make; its name becomes that of the system.
        size: pixels of a side, a multiple of 8.
        fps: frames a second to keep, at most those of the video (the default).
        crop: (left, top, width, height) in pixels of the video, a square, because lengths must be the same in both
            directions; by default the largest one in the middle.
        skip: seconds to leave out at the beginning of each video.
        until: second of each video at which to stop; by default its end.
        frames: frames of a recording.
        validation: part of the recordings for choices; at least one recording.
        test: part of the recordings for the test; at least one recording.
        constraints: a TOML file of keypoints and constraints, or the name of a mechanism; written into the folder.

    Returns:
        The folder.

    Raises:
        KeycldError: no such file, not a video, a bad crop, rate or number, too short videos, videos of different sizes
            or rates, a folder in use.

    Good values: recordings of about one swing; 30 to 60 frames a second; a still camera and background.
    """
    began = time.monotonic()
    sources = named_once(paths)
    _check_numbers(size, fps, frames, validation, test)
    check_span(skip, until)
    out = Path(out)
    check_folder(out)
    text = None if constraints is None else constraints_text(constraints)
    sizes = [probe(source)[:2] for source in sources]
    refuse_other_sizes(sources, sizes)
    if crop is not None:
        check_crop(crop, *sizes[0], sources[0])
    make_folder(out.parent)
    # The pictures wait on the disk without a name, so that a video may be larger than memory and a kill leaves nothing.
    with spool_in(out.parent) as spool:
        spans = [decode(source, spool, size, fps, crop, (skip, until), frames) for source in sources]
        rates = {round(rate, 3) for _, rate in spans}
        if len(rates) > 1:
            raise KeycldError(f"the videos have different frame rates {sorted(rates)}: give one with --fps.")
        total = sum(count for count, _ in spans)
        counts = _counts(total, validation, test, frames)
        recordings = np.memmap(spool, np.uint8, "r", shape=(total, frames, size, size, 3))
        ends = np.cumsum(counts)[:-1]
        parts: dict[str, np.ndarray] = dict(zip(SPLITS, np.split(recordings, ends), strict=True))
        return store(out, parts, origin(sources, spans[0][1]), text, began)


def constraints_text(constraints: str | Path) -> str:
    """Return the TOML text of a file of constraints or of a mechanism, checked.

    Raises:
        KeycldError: as `load_constraints`.
    """
    from keycld.mechanics import dump_constraints, load_constraints

    return dump_constraints(load_constraints(constraints))


def origin(sources: Sequence[Path], rate: float) -> dict[str, Any]:
    """Return the attributes of imported recordings with so many frames a second."""
    names = ", ".join(source.name for source in sources)
    if len(names) > _LONGEST_NAMES:
        names = f"{len(sources)} videos, {names[:_LONGEST_NAMES]}…"
    return {
        "dt": 1.0 / rate,
        "seed": 0,
        "input_names": (),
        "generator": f"keycld {__version__}, import of {names}",
        "protocol": "import",
    }


def store(
    out: Path, parts: dict[str, np.ndarray], attributes: dict[str, Any], constraints: str | None, began: float
) -> Path:
    """Write recordings without inputs as a data set.

    Args:
        out: the folder; its name becomes that of the system.
        parts: pictures uint8 `[N, T, H, W, 3]` of each split.
        attributes: of all files.
        constraints: TOML text, or None.
        began: when the work began, by `time.monotonic`.

    Returns:
        The folder.

    Raises:
        KeycldError: it holds other data, or cannot be written.
    """
    attributes = {"system": out.resolve().name, **attributes}
    with alone(out):
        partial = claim(out)
        for name, images in parts.items():
            write(out / f"{name}.h5", as_trajectories(images, attributes))
        if constraints is not None:
            write_text(out / CONSTRAINTS, constraints)
        finish(out, {"seconds": round(time.monotonic() - began, 1)})
        shutil.rmtree(partial)
    return out


def check_folder(out: Path) -> None:
    """Refuse a folder that cannot become the data set of a video.

    Raises:
        KeycldError: it is called like a system of keycld, or as `refuse_used`.
    """
    name = out.resolve().name
    if name in names():
        raise KeycldError(f"the folder name '{name}' is the name of a system of keycld: choose another name for {out}.")
    refuse_used(out)


def refuse_other_sizes(paths: Sequence[Path], sizes: Sequence[tuple[int, int]]) -> None:
    """Refuse videos that no single camera in one place can have recorded; sizes are (width, height) of each.

    Raises:
        KeycldError: names the first that differs.
    """
    for path, (width, height) in zip(paths, sizes, strict=True):
        if (width, height) != sizes[0]:
            raise KeycldError(
                f"{path} has {width} x {height} pixels, {paths[0]} {sizes[0][0]} x {sizes[0][1]}: give videos from the "
                "same camera and place."
            )


def check_size_and_rate(size: int, fps: float | None) -> None:
    """Refuse sides of pictures that a U-Net cannot halve three times, and a rate that is not positive.

    Raises:
        KeycldError: names the option.
    """
    if size < 8 or size % 8:
        raise KeycldError(f"--size is a positive multiple of 8, not {size}.")
    if fps is not None and not 0 < fps < float("inf"):
        raise KeycldError(f"--fps is above 0, not {fps}.")


def check_span(skip: float, until: float | None) -> None:
    """Refuse a part of a video that has no length.

    Raises:
        KeycldError: names the option.
    """
    if not 0 <= skip < float("inf"):
        raise KeycldError(f"--from is a second of the video, at least 0, not {skip:g}.")
    if until is not None and not skip < until < float("inf"):
        raise KeycldError(f"--until is a second of the video after --from ({skip:g}), not {until:g}.")


def span_options(skip: float, until: float | None) -> list[str]:
    """Return the options that make ffmpeg read a part of its next input, from one second to another."""
    # Raw streams hold no times to skip to: even 0 s would skip all of them.
    begin = ["-ss", str(skip)] if skip else []
    return begin if until is None else [*begin, "-t", str(until - skip)]


def named_once(paths: str | Path | Sequence[str | Path]) -> list[Path]:
    """Return the videos of one or more paths.

    Raises:
        KeycldError: there is none, or one comes twice: training and test would share frames.
    """
    sources = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    if not sources:
        raise KeycldError("name at least one video.")
    for number, source in enumerate(sources):
        if source.resolve() in [other.resolve() for other in sources[:number]]:
            raise KeycldError(f"{source} is named twice, so training and test would share frames: name it once.")
    return sources


def _check_numbers(size: int, fps: float | None, frames: int, validation: float, test: float) -> None:
    check_size_and_rate(size, fps)
    if frames < 3:
        raise KeycldError(f"--frames is at least 3, not {frames}.")
    if frames * size * size * 3 > LARGEST_RECORDING:
        raise KeycldError(f"recordings of {frames} frames of {size} × {size} pixels are too large: make them smaller.")
    if not (validation >= 0 and test >= 0 and validation + test < 1):
        raise KeycldError(f"validation ({validation}) and test ({test}) are parts that leave some for training.")


def probe(path: Path) -> tuple[int, int, Fraction, float]:
    """Read width, height, frames a second as ffmpeg decodes the video (turned upright), and the seconds it claims.

    Raises:
        KeycldError: no such file, not a video.
    """
    if not path.is_file():
        raise KeycldError(f"there is no video {path}: check the path.")
    # The first line of this simple format is, for example, "YUV4MPEG2 W96 H64 F25:1 Ip A0:0 ...".
    options = ["-v", "info", *input_options(path), "-frames:v", "1", "-pix_fmt", "yuv420p", "-f", "yuv4mpegpipe", "-"]
    try:
        with ffmpeg(*options) as process:
            head = process.read(200)
            while process.read(2**20):
                pass
    except FfmpegError as error:
        raise unreadable(path, error) from error
    words = {word[:1]: word[1:] for word in head.split(b"\n")[0].decode("ascii", "replace").split()[1:]}
    try:
        rate = Fraction(words["F"].replace(":", "/"))
        return int(words["W"]), int(words["H"]), rate, described(process.said)
    except (KeyError, ValueError, ZeroDivisionError) as error:
        raise unreadable(path, "it has no pictures") from error


def unreadable(path: Path, reason: Exception | str) -> KeycldError:
    """Return the error for a file that ffmpeg cannot read as a video."""
    return KeycldError(f"{path} cannot be read as a video: convert it to MP4 first (ffmpeg: {reason}).")


@contextlib.contextmanager
def spool_in(folder: Path) -> Iterator[IO[bytes]]:
    """Yield a temporary file without a name."""
    try:
        with tempfile.TemporaryFile(dir=folder) as spool:
            yield spool
    except OSError as error:
        raise writing_error(folder, error) from error


def decode(
    path: Path,
    spool: IO[bytes],
    size: int,
    fps: float | None,
    crop: tuple[int, int, int, int] | None,
    span: tuple[float, float | None],
    frames: int,
    mapped: str = "",
) -> tuple[int, float]:
    """Append the recordings uint8 [N, frames, size, size, 3] of a video to a file; return N and frames a second.

    `span` is the part to read, from one second to another, or to the end. `mapped` is an ffmpeg filter that comes
    before the crop, such as `plane_filter`. Without a crop it is the largest square in the middle.
    """
    width, height, own, seconds = probe(path)
    rate = own if fps is None else Fraction(fps).limit_denominator(100_000)
    if not 0 < rate <= own + Fraction(1, 1000):
        raise KeycldError(f"--fps is above 0 and at most the {float(own):g} of {path}, not {fps}.")
    least = min(width, height)
    crop = crop or ((width - least) // 2, (height - least) // 2, least, least)
    # The rate comes first: it also makes the uneven frame times of phones equal. A gap of years in them would give
    # frames without end; no format spends less than some bytes on a frame of its own.
    before = f"{mapped}," if mapped else ""
    filters = f"fps={rate},{before}{crop_filter(crop, width, height)},scale={size}:{size}:flags=area"
    most, frame, count = 10_000 + path.stat().st_size // 8, size * size * 3, 0
    skip, until = span
    expected = math.ceil(max(0.0, min(seconds, until or seconds) - skip) * rate)
    progress = Counted(path.name[:12])
    source = [*span_options(skip, until), *input_options(path)]
    try:
        with ffmpeg("-v", "error", *source, "-vf", filters, "-pix_fmt", "rgb24", "-f", "rawvideo", "-") as process:
            while len(picture := process.read(frame)) == frame:
                spool.write(picture)
                count += 1
                if count > most:
                    raise KeycldError(
                        f"{path} gives more than {most} frames, too many for its size: its frame times are damaged, so "
                        "convert it to MP4 first, or give a lower --fps."
                    )
                if count < expected:
                    progress(count, expected)
    except FfmpegError as error:
        raise unreadable(path, error) from error
    if not count:
        raise KeycldError(
            f"{path} gives no frame after {skip:g} s at {float(rate):g} frames/s: skip less, or give a higher --fps."
        )
    progress(count, count)
    spool.seek(-(count % frames) * frame, 2)
    spool.truncate()
    return count // frames, float(rate)


def crop_filter(crop: Sequence[int], width: int, height: int) -> str:
    """Return the ffmpeg filter that keeps a square, pixels of a video of this size.

    Beyond the picture its border is continued: beside a black edge no network found a small ball.
    """
    left, top, side, _ = (int(number) for number in crop)
    x, y = max(0, -left), max(0, -top)
    wide, high = max(width + x, left + x + side), max(height + y, top + y + side)
    beyond = ""
    if (wide, high) != (width, height):
        borders = f"left={x}:top={y}:right={wide - width - x}:bottom={high - height - y}"
        # With colours of half the resolution, borders would begin at even numbers only.
        beyond = f"format=yuv444p,pad={wide}:{high}:{x}:{y},fillborders={borders}:mode=smear,"
    # Otherwise odd sides and places are rounded where colours have half the resolution.
    return f"{beyond}crop={side}:{side}:{left + x}:{top + y}:exact=1"


def check_crop(crop: tuple[int, int, int, int], width: int, height: int, path: Path) -> None:
    """Refuse a part to keep that is no square, or not inside of the picture.

    Raises:
        KeycldError: names the option.
    """
    left, top, crop_width, crop_height = crop
    if crop_width != crop_height:
        raise KeycldError(f"--crop is a square, not {crop_width} x {crop_height}: make both the same.")
    if crop_width < 1 or min(left, top) < 0 or left + crop_width > width or top + crop_height > height:
        place = " ".join(map(str, crop))
        raise KeycldError(f"--crop {place} does not lie inside the {width} x {height} pixels of {path}.")


def _counts(recordings: int, validation: float, test: float, frames: int) -> tuple[int, int, int]:
    held = max(1, round(validation * recordings)), max(1, round(test * recordings))
    if recordings - sum(held) < 1:
        raise KeycldError(
            f"the videos give {recordings} recordings of {frames} frames, but training, validation and test need "
            "one each: take a longer video, fewer --frames, or a higher --fps."
        )
    return recordings - sum(held), *held


def as_trajectories(image: np.ndarray, attributes: dict[str, Any]) -> Trajectories:
    """Return recordings `[N, T, H, W, 3]` without inputs; `attributes` give dt."""
    return Trajectories(
        time=np.arange(1, image.shape[1] + 1) * attributes["dt"],
        input=np.zeros((len(image), 0), np.float32),
        image=image,
        attributes=attributes,
    )
