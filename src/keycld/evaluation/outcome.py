"""What `evaluate` returns: the outcome of one protocol."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from keycld.evaluation.image_scores import ERROR_ARRAYS


@dataclass(frozen=True)
class Evaluation:
    """The outcome of one protocol: `scores` as JSON would hold them, `arrays` for the figures.

    `docs/evaluation.md` lists both.
    """

    scores: dict[str, Any]
    arrays: dict[str, np.ndarray]

    @property
    def errors(self) -> Float[np.ndarray, "N T"]:
        """Frame errors in the protocol's metric."""
        return self.arrays[ERROR_ARRAYS[self.scores["metric"]]]

    def baseline_errors(self, name: str) -> Float[np.ndarray, "N T"]:
        """Return the same of a trivial predictor."""
        return self.arrays[f"baseline_{ERROR_ARRAYS[self.scores['metric']]}_{name.replace(' ', '_')}"]

    @property
    def vpt(self) -> dict[str, Any]:
        """The valid prediction time at the first threshold."""
        return headline_vpt(self.scores)

    @property
    def valid(self) -> Bool[np.ndarray, "N T"]:
        """Whether the prediction has stayed below the first threshold; true of the frames before the scored part."""
        first, stop = self.scores["part"]
        frames, time = np.array(self.vpt["frames"])[:, None], np.arange(self.errors.shape[1])[None]
        return time >= stop - frames if self.scores["direction"] == "backward" else time < first + frames


def headline_vpt(scores: Mapping[str, Any]) -> dict[str, Any]:
    """Return the valid prediction time at the first threshold, of scores or of those of a trivial predictor."""
    return next(iter(scores["vpt"].values()))


def keypoint_names(known: Sequence[str], count: int) -> tuple[str, ...]:
    """Return the known names of so many keypoints; numbers where others are known, or none."""
    return tuple(known) if len(known) == count else tuple(f"keypoint_{k + 1}" for k in range(count))
