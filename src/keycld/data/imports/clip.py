"""Videos of one motion become a data set: crop to what moves, split in time."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from keycld._errors import KeycldError
from keycld._files import make_folder
from keycld.data.format.trajectories import Trajectories
from keycld.data.imports.exposure import EVENED, made_alike
from keycld.data.imports.look import LOOKED, Look, look_at, refuse_leaving, refuse_unlike
from keycld.data.imports.overlays import painted_over, pixels_of
from keycld.data.imports.plane import Plane, plane_filter
from keycld.data.imports.video import (
    as_trajectories,
    check_crop,
    check_folder,
    check_size_and_rate,
    check_span,
    constraints_text,
    decode,
    named_once,
    origin,
    spool_in,
    store,
)

if TYPE_CHECKING:
    from keycld.data.dataset import DataSet

MOST = 1200
"""Frames that are kept of a video; of longer ones it is every second, third, … one."""
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
        KeycldError: no such file, not a video, too short, nothing moves or in too few pixels, parts that leave the
            picture, the camera moves, a cut, a bad crop, plane, size or rate; videos of different sizes or rates; a
            folder in use; constraints that give a pivot, without a crop.
    """
    began, out = time.monotonic(), Path(out)
    sources = named_once(paths)
    text = None if constraints is None else constraints_text(constraints)
    if constraints is not None and crop is None:
        _refuse_given_pivots(constraints)
    check_size_and_rate(_SMALLEST if size is None else size, fps)
    check_folder(out)
    check_span(skip or 0.0, until)
    named = None if skip is None and until is None else (skip or 0.0, until)
    videos = [look_at(path, plane, plane_ratio, named) for path in sources]
    refuse_unlike(videos)
    width, height, rate = videos[0].width, videos[0].height, videos[0].rate
    if crop is not None:
        check_crop(crop, width, height, sources[0])
    elif constraints is not None:
        refuse_leaving(videos)
    square = crop or _square_around(videos)
    every = _every(max(video.seconds for video in videos), rate)
    asked = None if every == 1 else float(rate / every)
    painted = [pixels_of(box, width, height) for video in videos for box in video.overlays]
    filters = [] if plane is None else [plane_filter(plane, plane_ratio, width, height)]
    mapped = ",".join([*filters, painted_over(painted)] if painted else filters)
    make_folder(out.parent)
    with spool_in(out.parent) as spool:

        def pictures(side: int) -> _Pictures:
            return _decoded(videos, spool, side, asked, square, mapped)

        if constraints is None:
            # Keypoints are not looked for, so nothing need be large enough to be followed.
            found = pictures(_SMALLEST if size is None else size)
        else:
            where = f"in {sources[0]}" if crop is None else f"within --crop {' '.join(map(str, crop))} of {sources[0]}"
            found = _large_enough(pictures, size, where)
        parts, counts = _split(found.clips, longest, chain=text is not None and text.count("[[constraint]]") > 1)
        kept = found.fps if fps is None else fps / every
        attributes = origin(sources, kept) | {
            "protocol": CLIP,
            "crop": square,
            "kept_fps": found.fps,
            "video_size": (width, height),
            "mapped": mapped,
            "painted": np.array(painted, int).reshape(-1, 4),
            EVENED: found.exposure > 0,
            "exposure": found.exposure,
        }
        for name in ("train", "validation"):
            attributes[f"{name}_of_clips"] = [count // parts[name].shape[1] for count in counts[name]]
        if named is None:
            stretches = [(v.span[0], v.span[0] + v.seconds) for v in videos if v.span != (0.0, None)]
            attributes["stretches"] = np.array(stretches).reshape(-1, 2)
        store(out, parts, attributes, text, began)
    train, validation, test = (sum(counts[name]) for name in parts)
    side = found.clips[0].shape[1]
    return ImportedClip(out, square, side, kept, (train, validation, test), tuple(painted), found.exposure)


def _refuse_given_pivots(constraints: str | Path) -> None:
    """Refuse pivots in numbers: nobody knows them in a picture whose crop is yet to be found.

    Raises:
        KeycldError: names the keypoint.
    """
    from keycld.mechanics import DistanceToPoint, load_constraints

    for item in load_constraints(constraints).items:
        if isinstance(item, DistanceToPoint) and isinstance(item.point, tuple):
            raise KeycldError(
                f"{constraints} gives the pivot of '{item.keypoint}' in the cropped picture, but the crop is not "
                'known yet: add --crop LEFT TOP WIDTH HEIGHT, or write point = "unknown".'
            )


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


def _every(seconds: float, rate: Fraction) -> int:
    """Return 1 where all frames are kept, 2 where it is every second one, and so on."""
    return max(1, math.ceil(Fraction(round(seconds * rate), MOST)))


class _Pictures(NamedTuple):
    """The frames of each video, in a file; their frames a second; by how much their exposure varied."""

    clips: list[UInt8[np.ndarray, "_ H W 3"]]
    fps: float
    exposure: float


def _decoded(
    videos: Sequence[Look], spool: IO[bytes], side: int, fps: float | None, crop: tuple[int, int, int, int], mapped: str
) -> _Pictures:
    """Return the pictures of this side, in place of what the file held before."""
    spool.seek(0)
    spool.truncate()
    found = [decode(video.path, spool, side, fps, crop, video.span, 1, mapped) for video in videos]
    ends = np.cumsum([count for count, _ in found])
    images = np.memmap(spool, np.uint8, "r+", shape=(int(ends[-1]), side, side, 3))
    clips = np.split(images, ends[:-1])
    return _Pictures(clips, found[0][1], made_alike(clips, _TRAIN))


def _large_enough(pictures: Callable[[int], _Pictures], size: int | None, where: str) -> _Pictures:
    """Return pictures in which what moves can be followed.

    Args:
        pictures: gives those of a side.
        size: the side that the user asked for; None: 64, or up to 128 where parts are small.
        where: in what it moves, for messages.

    Raises:
        KeycldError: nothing moves in most frames, or in too few pixels.
    """
    side = _SMALLEST if size is None else size
    found = pictures(side)
    needed = _needed_side(found.clips)
    if needed is None:
        raise KeycldError(
            f"nothing moves in most frames {where}: name the seconds in which the parts move with --from and "
            "--until, or the square around them with --crop."
        )
    if needed <= side:
        return found
    if size is None and needed <= _LARGEST:
        return pictures(needed)
    raise KeycldError(
        f"what moves {where} covers less than {_TINY:g} pixels of pictures of {side} x {side}, too few to be followed: "
        f"add --size {needed}, or --crop closer around it."
    )


def _split(
    clips: Sequence[UInt8[np.ndarray, "_ H W 3"]], longest: int, *, chain: bool
) -> tuple[dict[str, np.ndarray], dict[str, list[int]]]:
    """Return the recordings of each part, and how many frames of each clip it has."""
    split: dict[str, list[np.ndarray]] = {"train": [], "validation": [], "test": []}
    for clip in clips:
        bounds = round(_TRAIN * len(clip)), len(clip) - round(_TEST * len(clip))
        for name, some in zip(split, np.split(clip, bounds), strict=True):
            split[name].append(some)
    parts = {name: _recordings(some, longest, last=name == "train") for name, some in split.items()}
    if len(parts["train"]) == 1 and chain:
        # A chain's motion is fitted in halves: after a while nearby motions part.
        parts["train"] = _recordings(split["train"], (len(split["train"][0]) + 1) // 2, last=True)
    return parts, {name: [len(clip) for clip in some] for name, some in split.items()}


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


def _needed_side(clips: Sequence[UInt8[np.ndarray, "_ H W 3"]]) -> int | None:
    """Return the side of pictures in which what moves can be followed: larger ones where it is hardly a pixel large.

    None if most pictures differ nowhere from their median.
    """
    images = np.concatenate([clip[:: max(1, len(clip) * len(clips) // LOOKED)] for clip in clips]).astype(np.int16)
    off = np.max(np.abs(images - np.median(images, axis=0).astype(np.int16)[None]), axis=-1)
    off = np.maximum(off - 12, 0).reshape(len(off), -1)
    covered = float(np.median(np.sum(off, axis=1) / np.maximum(np.max(off, axis=1), 1)))
    if covered == 0:
        return None
    size = images.shape[1]
    return size if covered >= _TINY else 8 * math.ceil(size * math.sqrt(2 * _TINY / covered) / 8)


def _square_around(videos: Sequence[Look], margin: float = 0.15) -> tuple[int, int, int, int]:
    """Return left, top, width and height of the square around what moves, with a margin, inside of the picture.

    It reaches beyond the picture to both sides where the part is longer than that is wide, as in upright videos.
    """
    corners, width, height = np.array([video.part for video in videos]), videos[0].width, videos[0].height
    (left, top), (right, bottom) = corners[:, :2].min(axis=0), corners[:, 2:].max(axis=0)
    left, top, right, bottom = left * width, top * height, right * width, bottom * height
    longest = max(right - left, bottom - top)
    most = min(width, height) if longest <= min(width, height) else max(width, height)
    side = max(8, min(most, round((1 + 2 * margin) * longest)))
    x, y = round((left + right - side) / 2), round((top + bottom - side) / 2)
    return _inside(x, side, width), _inside(y, side, height), side, side


def _inside(first: int, side: int, length: int) -> int:
    """Return where a side of a square begins to be inside of a length, or to reach beyond it to both ends alike."""
    return min(max(first, 0), length - side) if side <= length else (length - side) // 2
