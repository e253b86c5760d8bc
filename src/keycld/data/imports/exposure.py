"""A camera that adapts its exposure, or a flickering lamp, changes the whole picture: frames are made alike."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

if TYPE_CHECKING:
    from keycld.data.dataset import DataSet

# Frames that the usual picture is made of, and that are changed at a time.
_FRAMES, _CHUNK = 100, 500
# Deviation over time, as a share, from which on the exposure varies.
_VARIES = 0.005
# Values of places that tell it: darker ones are noise, brighter ones may be clipped. At least this share is between.
_DARK, _BRIGHT, _LEAST = 16, 240, 0.05
EVENED = "exposure_evened"
"""Attribute of a data set whose frames have been made alike."""


class Usual(NamedTuple):
    """What a camera at rest usually sees.

    Attributes:
        picture: median of the frames.
        steady: the places that tell how a frame was exposed: the half that changes least, not dark and not clipped.
    """

    picture: Float[np.ndarray, "H W C"]
    steady: Bool[np.ndarray, "H W"]

    def exposures(self, frames: UInt8[np.ndarray, "T H W C"]) -> Float[np.ndarray, "T C"]:
        """Return how bright each frame is next to the picture, for each colour; 1 where too few places tell it.

        It is the mean of the middle half of the ratios of the steady places, which parts that pass a few of them hardly
        change; the median would have steps of the numbers of a pixel.
        """
        if not self.steady.any():
            return np.ones((len(frames), frames.shape[-1]))
        ratios = np.sort(frames[:, self.steady] / self.picture[self.steady], axis=1)
        quarter = ratios.shape[1] // 4
        return np.mean(ratios[:, quarter : ratios.shape[1] - quarter], axis=1)

    def evened(self, frames: UInt8[np.ndarray, "T H W C"]) -> UInt8[np.ndarray, "T H W C"]:
        """Return the frames as bright as the picture is."""
        even = frames / self.exposures(frames)[:, None, None]
        return np.clip(np.round(even), 0, 255).astype(np.uint8)


def usual_of(clips: Sequence[UInt8[np.ndarray, "_ H W C"]]) -> Usual:
    """Return what is usually seen in clips from one place."""
    count = max(1, _FRAMES // len(clips))
    some = np.concatenate([clip[np.linspace(0, len(clip) - 1, min(count, len(clip))).astype(int)] for clip in clips])
    picture = np.median(some, axis=0)
    shown = np.all((picture > _DARK) & (picture < _BRIGHT), axis=-1)
    if np.mean(shown) < _LEAST:
        return Usual(picture, np.zeros_like(shown))
    even = some / Usual(picture, shown).exposures(some)[:, None, None]
    # A part is at a place for a short time or a long one: the mean deviation knows of both.
    changes = np.max(np.mean(np.abs(even / np.maximum(picture, 1) - 1), axis=0), axis=-1)
    return Usual(picture, shown & (changes <= np.median(changes[shown])))


def made_alike(clips: Sequence[UInt8[np.ndarray, "_ H W C"]], share: float = 1.0) -> float:
    """Make the frames of clips from one place as bright as they usually are, in place, if their exposure varies.

    Args:
        clips: of one place.
        share: of the frames of each, from its beginning, that tell what is usual.

    Returns:
        The standard deviation of the exposure over time, as a share of it, where frames were changed; otherwise 0.
    """
    usual = usual_of([clip[: max(1, round(share * len(clip)))] for clip in clips])
    exposures = [usual.exposures(clip[begin : begin + _CHUNK]) for clip in clips for begin in _begins(clip)]
    varies = float(np.max(np.std(np.concatenate(exposures), axis=0)))
    if varies < _VARIES:
        return 0.0
    for clip in clips:
        for begin in _begins(clip):
            clip[begin : begin + _CHUNK] = usual.evened(clip[begin : begin + _CHUNK])
    return varies


def usual_for(data: "DataSet") -> Usual | None:
    """Return what other frames from the place of a data set are made alike to; None: they are left as they are."""
    if not data.attributes.get(EVENED, False):
        return None
    image = data.train().image
    assert image is not None
    return usual_of([image.reshape(-1, *image.shape[2:])])


def _begins(clip: np.ndarray) -> range:
    return range(0, len(clip), _CHUNK)
