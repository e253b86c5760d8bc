"""Frames of a camera, or of a video played as one, as they come."""

import queue
import stat
import threading
from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from keycld._errors import KeycldError
from keycld._ffmpeg import FfmpegError, ffmpeg, input_options
from keycld.data.imports.clip import is_clip
from keycld.data.imports.exposure import Usual
from keycld.data.imports.same_camera import kept_rate
from keycld.data.imports.video import crop_filter, unreadable


class Seen(NamedTuple):
    """One frame, cropped as the clips of a data set were.

    Attributes:
        view: for people, `[view, view, 3]`.
        frame: for the model, `[size, size, 3]`.
    """

    view: UInt8[np.ndarray, "V V 3"]
    frame: UInt8[np.ndarray, "S S 3"]


def camera_frames(
    source: str | Path, like: Mapping[str, Any], size: int, view: int = 512, *, usual: Usual | None = None
) -> Iterator[list[Seen]]:
    """Yield the frames that have come since the last ones were taken, at least one; in all, every frame once.

    A file is played at its own speed, so whoever takes long for some frames gets several at once, as from a camera.

    Args:
        source: a video, or a camera as the system names it, such as /dev/video0 (Video4Linux).
        like: attributes of a data set that was made of a clip from the same camera and place.
        size: pixels of a side for the model.
        view: pixels of a side for people.
        usual: what the frames for the model are made alike to (`usual_for`); None: nothing.

    Raises:
        KeycldError: no such source, not a video, of another size; the data set is not made of a clip; the camera stops.
    """
    source = Path(source)
    camera = _is_camera(source)
    rate, options = _camera(source, like) if camera else _played(source, like)
    cropped = crop_filter(like["crop"], *(int(side) for side in like["video_size"]))
    mapped = f"{like['mapped']}," if like.get("mapped") else ""
    # Both sizes in one picture, the smaller one below; of the same filter as in the import.
    filters = (
        f"fps={rate},{mapped}{cropped},split[a][b];[a]scale={size}:{size}:flags=area,"
        f"pad={view}:{size}[small];[b]scale={view}:{view}:flags=bicubic[large];[large][small]vstack"
    )
    shape = (view + size, view, 3)
    frames: queue.Queue[Seen | FfmpegError | None] = queue.Queue()
    ended = threading.Event()

    def read() -> None:
        try:
            with ffmpeg("-v", "error", *options, "-vf", filters, "-pix_fmt", "rgb24", "-f", "rawvideo", "-") as process:
                while not ended.is_set() and len(picture := process.read(int(np.prod(shape)))) == np.prod(shape):
                    both = np.frombuffer(picture, np.uint8).reshape(shape)
                    frame = both[view:, :size]
                    frames.put(Seen(both[:view], frame if usual is None else usual.evened(frame[None])[0]))
                if ended.is_set():
                    process.end()
            frames.put(None)
        except FfmpegError as error:
            frames.put(error)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        yield from _taken(frames)
    except FfmpegError as error:
        if not camera:
            raise unreadable(source, error) from error
        raise KeycldError(
            f"{source} is no camera that gives pictures of the size of the learned video (ffmpeg: {error})."
        ) from error
    finally:
        ended.set()
        reader.join()


def _is_camera(source: Path) -> bool:
    """Return whether the system's name is that of a device."""
    try:
        return stat.S_ISCHR(source.stat().st_mode)
    except OSError:
        return False


def _played(video: Path, like: Mapping[str, Any]) -> tuple[Fraction, list[str]]:
    """Return the frames a second to keep, and ffmpeg's options for a video at its own speed."""
    rate, own, _ = kept_rate(video, like)
    return min(rate, own), ["-re", *input_options(video)]


def _camera(device: Path, like: Mapping[str, Any]) -> tuple[Fraction, list[str]]:
    """Return the frames a second to keep, and ffmpeg's options for a camera."""
    if not is_clip(like):
        raise KeycldError(f"{device} is a camera, but the model learned from other data: give a run of keycld watch.")
    width, height = (int(side) for side in like["video_size"])
    rate = Fraction(float(like["kept_fps"])).limit_denominator(100_000)
    return rate, ["-f", "v4l2", "-video_size", f"{width}x{height}", "-i", str(device)]


def _taken(frames: "queue.Queue[Seen | FfmpegError | None]") -> Iterator[list[Seen]]:
    """Yield what has come, in order, until the end."""
    while True:
        waiting = [frames.get()]
        while not frames.empty():
            waiting.append(frames.get())
        seen = [each for each in waiting if isinstance(each, Seen)]
        if seen:
            yield seen
        if not isinstance(waiting[-1], Seen):
            if waiting[-1] is not None:
                raise waiting[-1]
            return
