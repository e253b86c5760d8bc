"""Another video of a camera whose clip was learned."""

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from keycld._errors import KeycldError
from keycld._files import make_folder
from keycld.data.format.writing import write
from keycld.data.imports.clip import MOST, is_clip
from keycld.data.imports.exposure import Usual
from keycld.data.imports.video import as_trajectories, decode, origin, probe, spool_in


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
    if seconds * kept > MOST:
        raise KeycldError(f"{video} has more than {MOST} frames: cut out the part to predict.")
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
    width, height, rate, seconds = probe(video)
    if not is_clip(like):
        raise KeycldError(
            f"{video} is a video, but the model learned from other data: make a data set of it with `keycld data "
            f"import {video} --out FOLDER`, or learn its physics with `keycld watch {video} --mechanism auto`."
        )
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
