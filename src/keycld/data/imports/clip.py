"""Videos of one motion become a data set: crop to what moves, split in time."""

import math
import time
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8

from keycld._errors import KeycldError
from keycld._ffmpeg import FfmpegError, ffmpeg, input_options
from keycld._files import make_folder
from keycld.data.format.trajectories import Trajectories
from keycld.data.format.writing import write
from keycld.data.imports.exposure import EVENED, Usual, made_alike
from keycld.data.imports.overlays import Box, overlays, painted_over, pixels_of
from keycld.data.imports.plane import Plane, plane_filter
from keycld.data.imports.stretch import undisturbed
from keycld.data.imports.video import (
    as_trajectories,
    check_crop,
    check_folder,
    check_size_and_rate,
    check_span,
    constraints_text,
    decode,
    origin,
    probe,
    refuse_other_sizes,
    span_options,
    spool_in,
    store,
    unreadable,
)

if TYPE_CHECKING:
    from keycld.data.dataset import DataSet

_FEWEST, _MOST = 60, 1200
"""Frames of a video; of longer ones every second, third, … frame is kept."""
_LOOKED, _SIDE = 300, 160
"""Frames and pixels of the shorter side in which motion is looked for."""
_TRAIN, _TEST = 0.6, 1 / 3
"""Shares of the frames: the first ones for training, the last ones for the test."""
# Pixels that the parts of a mechanism cover at least.
_TINY = 5.0
_SMALLEST, _LARGEST = 64, 128
"""Sides of pictures that are chosen where none is given."""
CLIP = "clip"
"""The split plan of a data set that was made of a clip."""


class ImportedClip(NamedTuple):
    """What was made of one or more videos.

    Attributes:
        folder: the data set.
        crop: left, top, width and height of the part that is kept, pixels of the videos; it may reach beyond them,
            where their border is continued.
        size: pixels of a side of the pictures.
        fps: frames a second of the recordings, in the time of the camera.
        frames: of training, validation and test, of all videos.
        painted: left, top, width and height of places that change without moving, such as a clock, pixels of the
            videos. They are painted over.
        exposure: by how much the exposure varied, a standard deviation as a share of it, where this was evened out;
            otherwise 0.
    """

    folder: Path
    crop: tuple[int, int, int, int]
    size: int
    fps: float
    frames: tuple[int, int, int]
    painted: tuple[tuple[int, int, int, int], ...] = ()
    exposure: float = 0.0


class _Video(NamedTuple):
    """A video that was looked at.

    Its size, frames a second, from which second to which it is used, and how many these are; the part that moves, and
    what only changes.
    """

    path: Path
    width: int
    height: int
    rate: Fraction
    span: tuple[float, float | None]
    seconds: float
    part: Box
    overlays: list[Box]


def import_clip(
    paths: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    constraints: str | Path | None,
    size: int | None = 64,
    fps: float | None = None,
    crop: tuple[int, int, int, int] | None = None,
    plane: Plane | None = None,
    plane_ratio: float = 1.0,
    skip: float | None = None,
    until: float | None = None,
    longest: int = 400,
) -> ImportedClip:
    """Make a data set of one video of one motion, of 60 frames to some minutes, or of several from the same place.

    The first three fifths of the frames are for training, the last third for the test, those between for validation.
    Each part is one recording, or several of equal length after one another. Of several videos all recordings of a part
    have the length of the shortest. All frames are kept up to 1200, of longer videos every second, third, … one. Only
    the longest stretch that shows the mechanism alone and in motion is used (`undisturbed`). Places that change without
    moving are painted over, and an exposure that varies is evened out (`made_alike`).

    Args:
        paths: videos of one mechanism, any format that ffmpeg reads.
        out: the folder to make.
        constraints: a TOML file of keypoints and constraints, or the name of a mechanism; None: without any.
        size: pixels of a side of the pictures, a multiple of 8; None: 64, or up to 128 where parts are small.
        fps: frames a second with which the camera recorded, where the file states another rate (slow motion).
        crop: (left, top, width, height), a square in pixels of the video; by default the part in which something moves.
        plane: corners of a rectangle in the plane of the motion, which is then mapped to its view from the front. A
            crop is one of the mapped video.
        plane_ratio: width of that rectangle divided by its height.
        skip: seconds to leave out at the beginning of each video; with `until`, the second at which to stop, it takes
            the place of the stretch that is found.
        until: by default the end.
        longest: the most frames of a recording.

    Raises:
        KeycldError: no such file, not a video, too short, nothing moves or in too few pixels, the camera moves, a cut,
            a bad crop, plane, size or rate; videos of different sizes or rates; a folder in use.
    """
    began, out = time.monotonic(), Path(out)
    sources = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    text = None if constraints is None else constraints_text(constraints)
    side = _SMALLEST if size is None else size
    check_size_and_rate(side, fps)
    check_folder(out)
    check_span(skip or 0.0, until)
    named = None if skip is None and until is None else (skip or 0.0, until)
    videos = [_looked_at(path, plane, plane_ratio, named) for path in sources]
    _refuse_unlike(videos)
    first = videos[0]
    corners = np.array([video.part for video in videos])
    part = (*corners[:, :2].min(axis=0).tolist(), *corners[:, 2:].max(axis=0).tolist())
    if crop is not None:
        check_crop(crop, first.width, first.height, sources[0])
    chosen = crop or _square_around(part, first.width, first.height)
    every = max(1, math.ceil(max(video.seconds for video in videos) * first.rate / _MOST))
    painted = [pixels_of(box, first.width, first.height) for video in videos for box in video.overlays]
    filters = [] if plane is None else [plane_filter(plane, plane_ratio, first.width, first.height)]
    mapped = ",".join([*filters, painted_over(painted)] if painted else filters)
    make_folder(out.parent)
    with spool_in(out.parent) as spool:
        asked = None if every == 1 else float(first.rate / every)
        clips, kept, exposure = _pictures(videos, spool, side, asked, chosen, mapped)
        needed = side if constraints is None else _needed_side(clips)
        if needed is None:
            where = f"in {sources[0]}" if crop is None else f"within --crop {' '.join(map(str, crop))} of {sources[0]}"
            raise KeycldError(
                f"nothing moves in most frames {where}: name the seconds in which the parts move with --from and "
                "--until, or the square around them with --crop."
            )
        if size is None and side < needed <= _LARGEST:
            side = needed
            clips, kept, exposure = _pictures(videos, spool, side, asked, chosen, mapped)
        elif side < needed:
            raise KeycldError(
                f"what moves in {sources[0]} covers less than {_TINY:g} pixels of pictures of {side} x {side}, too few "
                f"to be followed: add --size {needed}, or --crop closer around it."
            )
        rate = kept if fps is None else fps / every
        split: dict[str, list[np.ndarray]] = {"train": [], "validation": [], "test": []}
        for clip in clips:
            bounds = round(_TRAIN * len(clip)), len(clip) - round(_TEST * len(clip))
            for name, some in zip(split, np.split(clip, bounds), strict=True):
                split[name].append(some)
        parts = {name: _recordings(clips, longest, last=name == "train") for name, clips in split.items()}
        if len(parts["train"]) == 1 and text is not None and text.count("[[constraint]]") > 1:
            # A chain's motion is fitted in halves: after a while nearby motions part.
            parts["train"] = _recordings(split["train"], (len(split["train"][0]) + 1) // 2, last=True)
        attributes = origin(sources, rate) | {"protocol": CLIP, "crop": chosen, "kept_fps": kept}
        for name in ("train", "validation"):
            attributes[f"{name}_of_clips"] = [len(clip) // parts[name].shape[1] for clip in split[name]]
        attributes |= {"video_size": (first.width, first.height), "mapped": mapped, EVENED: exposure > 0}
        attributes |= {"painted": np.array(painted, int).reshape(-1, 4), "exposure": exposure}
        if named is None:
            parts_used = [(v.span[0], v.span[0] + v.seconds) for v in videos if v.span != (0.0, None)]
            attributes["stretches"] = np.array(parts_used).reshape(-1, 2)
        store(out, parts, attributes, text, began)
    frames = [sum(len(clip) for clip in clips) for clips in split.values()]
    return ImportedClip(out, chosen, side, rate, (frames[0], frames[1], frames[2]), tuple(painted), exposure)


def is_clip(attributes: Mapping[str, Any]) -> bool:
    """Return whether a data set with these attributes was made of a clip."""
    return attributes.get("protocol") == CLIP


def changes_of(attributes: Mapping[str, Any]) -> list[str]:
    """Say what was left out of a clip and changed in its pictures, from the attributes of its data set."""
    said = [
        f"only seconds {begin:.1f} to {end:.1f} are used, in which it shows the mechanism alone and in motion"
        for begin, end in attributes.get("stretches", ())
    ]
    said += [
        f"what changes without moving, such as a clock, is painted over: {width} × {height} pixels at {left}, {top}"
        for left, top, width, height in attributes.get("painted", ())
    ]
    exposure = float(attributes.get("exposure", 0.0))
    return [*said, f"the exposure varies by {exposure:.1%}; it is evened out"] if exposure else said


def before_test(data: "DataSet") -> Trajectories:
    """Return the training recordings of a clip, each clip's continued by its validation part.

    About as many recordings as for training, of one length. Of other data it is the training split.
    """
    train = data.train()
    if not is_clip(data.attributes):
        return train
    validation = data.validation()
    assert train.image is not None and validation.image is not None

    def clips(name: str, image: np.ndarray) -> list[np.ndarray]:
        counts = data.attributes.get(f"{name}_of_clips", [len(image)])
        return [each.reshape(-1, *each.shape[2:]) for each in np.split(image, np.cumsum(counts)[:-1])]

    pairs = list(zip(clips("train", train.image), clips("validation", validation.image), strict=True))
    longest = max(math.ceil((len(first) + len(then)) * train.frames / len(first)) for first, then in pairs)
    image = _recordings([np.concatenate(pair) for pair in pairs], longest, last=True)
    return as_trajectories(image, dict(train.attributes))


def clip_file(
    video: str | Path, out: str | Path, like: Mapping[str, Any], size: int, *, usual: Usual | None = None
) -> Path:
    """Write all frames of a video as one recording, cropped and at the rate of a data set that was made of a clip.

    Args:
        video: from the same camera and place as the data set's.
        out: HDF5 file to write.
        like: attributes of the data set.
        size: pixels of a side of the pictures.
        usual: what the frames are made alike to (`usual_for`); None: nothing.

    Raises:
        KeycldError: no such file, not a video, of another size, too long; the data set is not made of a clip.
    """
    video, out = Path(video), Path(out)
    kept, own, seconds = kept_rate(video, like)
    if seconds * kept > _MOST:
        raise KeycldError(f"{video} has more than {_MOST} frames: cut out the part to predict.")
    left, top, crop_width, crop_height = (int(number) for number in like["crop"])
    make_folder(out.parent)
    with spool_in(out.parent) as spool:
        asked = None if abs(kept - own) < Fraction(1, 100) else float(kept)
        total, _ = decode(
            video, spool, size, asked, (left, top, crop_width, crop_height), (0.0, None), 1, str(like.get("mapped", ""))
        )
        images = np.memmap(spool, np.uint8, "r", shape=(total, size, size, 3))
        even = images if usual is None else usual.evened(images)
        attributes = origin([video], 1 / float(like["dt"])) | {"system": str(like["system"])}
        write(out, as_trajectories(np.asarray(even)[None], attributes))
    return out


def kept_rate(video: Path, like: Mapping[str, Any]) -> tuple[Fraction, Fraction, float]:
    """Return frames a second that a data set's clips were kept at, a video's own, and its seconds.

    Args:
        video: from the same camera and place as the data set's.
        like: attributes of the data set.

    Raises:
        KeycldError: no such file, not a video, of another size, too slow; the data set is not made of a clip.
    """
    if not is_clip(like):
        raise KeycldError(f"{video} is a video, but the model learned from other data: give an HDF5 file.")
    width, height, rate, seconds = probe(video)
    own = tuple(int(side) for side in like["video_size"])
    if (width, height) != own:
        raise KeycldError(
            f"{video} has {width} x {height} pixels, the video that was learned {own[0]} x {own[1]}: give one from the "
            "same camera and place."
        )
    kept = Fraction(float(like["kept_fps"])).limit_denominator(100_000)
    if kept > rate + Fraction(1, 100):
        raise KeycldError(f"{video} has {float(rate):g} frames a second, but the model needs {float(kept):g}.")
    return kept, rate, seconds


def _looked_at(path: Path, plane: Plane | None, plane_ratio: float, named: tuple[float, float | None] | None) -> _Video:
    """Read what a part of a video shows, and refuse one that shows no motion of a mechanism.

    The part is from one second to another, or None: the longest stretch that shows the mechanism alone and in motion.

    Raises:
        KeycldError: no such file, not a video, too short, nothing moves, the camera moves, a cut; a bad plane.
    """
    width, height, rate, whole = probe(path)
    skip, until = named or (0.0, None)
    seconds = max(0.0, min(whole, until or whole) - skip)
    mapped = "" if plane is None else f"{plane_filter(plane, plane_ratio, width, height)},"
    every = max(1, math.floor(seconds * rate / _LOOKED))
    grey, dt = _grey(path, width, height, rate / every, (skip, until), mapped), float(every / rate)
    if len(grey) < _FEWEST:
        part = "" if named is None else " in this part"
        raise KeycldError(f"{path} has {len(grey)} frames{part}, but {_FEWEST} are the least: record a longer video.")
    # Raw streams, whose length is not known, hold no times to skip to.
    chosen = named is None and whole > 0
    # A camera that is touched at the beginning or end changes the whole picture; this is left out below.
    edge = len(grey) // 10 if chosen else 0
    _refuse_cuts(grey[edge : len(grey) - edge], path, skip + edge * dt, dt)
    made_alike([grey[..., None]])
    differs = _differs(grey)
    part, overlays = _moving_part(differs, path)
    first, last = undisturbed(grey, differs, dt) if chosen else (0, len(grey))
    if last - first < min(_FEWEST, len(grey)):
        raise KeycldError(
            f"the longest stretch of {path} that shows the mechanism alone and in motion has {last - first} frames, "
            f"but {_FEWEST} are the least: record a longer one, or name the seconds to use with --from and --until."
        )
    if (first, last) != (0, len(grey)):
        skip, until = first * dt, None if last == len(grey) else last * dt
        part, overlays = _moving_part(_differs(grey[first:last]), path)
    return _Video(path, width, height, rate, (skip, until), (last - first) * dt, part, overlays)


def _pictures(
    videos: Sequence[_Video],
    spool: IO[bytes],
    side: int,
    fps: float | None,
    crop: tuple[int, int, int, int],
    mapped: str,
) -> tuple[list[UInt8[np.ndarray, "_ H W 3"]], float, float]:
    """Return the frames of each video, in a file; their frames a second; by how much their exposure varied.

    Frames that the file held before are gone.
    """
    spool.seek(0)
    spool.truncate()
    found = [decode(video.path, spool, side, fps, crop, video.span, 1, mapped) for video in videos]
    ends = np.cumsum([count for count, _ in found])
    images = np.memmap(spool, np.uint8, "r+", shape=(int(ends[-1]), side, side, 3))
    clips = np.split(images, ends[:-1])
    return clips, found[0][1], made_alike(clips, _TRAIN)


def _refuse_unlike(videos: Sequence[_Video]) -> None:
    """Refuse videos of different sizes or rates."""
    refuse_other_sizes([video.path for video in videos], [(video.width, video.height) for video in videos])
    first = videos[0]
    for video in videos[1:]:
        if abs(video.rate - first.rate) > Fraction(1, 100):
            raise KeycldError(
                f"{video.path} has {float(video.rate):g} frames a second, {first.path} {float(first.rate):g}: give "
                "videos of one rate."
            )


def _recordings(clips: Sequence[np.ndarray], longest: int, *, last: bool = False) -> np.ndarray:
    """Return frames `[T, …]` of each clip as recordings `[N, T', …]`, as long as `longest` and the shortest allow.

    What does not fill a recording is dropped at the end of the clip; with `last` at its beginning.
    """
    shortest = min(len(clip) for clip in clips)
    length = shortest // math.ceil(shortest / longest)
    cut = []
    for clip in clips:
        kept = len(clip) // length * length
        cut.append((clip[len(clip) - kept :] if last else clip[:kept]).reshape(-1, length, *clip.shape[1:]))
    return cut[0] if len(cut) == 1 else np.concatenate(cut)


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
            while len(picture := process.read(w * h)) == w * h and len(found) < 4 * _LOOKED:
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


def _needed_side(clips: Sequence[UInt8[np.ndarray, "_ H W 3"]]) -> int | None:
    """Return the side of pictures in which what moves can be followed: larger ones where it is hardly a pixel large.

    None if most pictures differ nowhere from their median.
    """
    images = np.concatenate([clip[:: max(1, len(clip) * len(clips) // _LOOKED)] for clip in clips]).astype(np.int16)
    off = np.max(np.abs(images - np.median(images, axis=0).astype(np.int16)[None]), axis=-1)
    off = np.maximum(off - 12, 0).reshape(len(off), -1)
    covered = float(np.median(np.sum(off, axis=1) / np.maximum(np.max(off, axis=1), 1)))
    if covered == 0:
        return None
    size = images.shape[1]
    return size if covered >= _TINY else 8 * math.ceil(size * math.sqrt(2 * _TINY / covered) / 8)


def _square_around(
    part: tuple[float, float, float, float], width: int, height: int, margin: float = 0.15
) -> tuple[int, int, int, int]:
    """Return left, top, width and height of the square around a part, with a margin, inside of the picture.

    It reaches beyond the picture to both sides where the part is longer than that is wide, as in upright videos.
    """
    left, top, right, bottom = part[0] * width, part[1] * height, part[2] * width, part[3] * height
    longest = max(right - left, bottom - top)
    most = min(width, height) if longest <= min(width, height) else max(width, height)
    side = max(8, min(most, round((1 + 2 * margin) * longest)))
    x, y = round((left + right - side) / 2), round((top + bottom - side) / 2)
    return _inside(x, side, width), _inside(y, side, height), side, side


def _inside(first: int, side: int, length: int) -> int:
    """Return where a side of a square begins to be inside of a length, or to reach beyond it to both ends alike."""
    return min(max(first, 0), length - side) if side <= length else (length - side) // 2
