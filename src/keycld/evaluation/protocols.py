"""What a model is given, which frames are scored, with which metric, and against which thresholds."""

import math
from dataclasses import dataclass

from keycld._errors import KeycldError, unknown

METRICS = {"squared": "mean squared error", "normalised": "normalised error"}
"""Errors of a frame: what they are called in words, by name."""
DIRECTIONS = ("forward", "backward")


@dataclass(frozen=True)
class Protocol:
    """How a prediction is scored.

    A window of `horizon` frames is taken from each recording, from frame `start` on; what lies outside is neither shown
    to the model nor scored. The model gets `given` frames of the window and its inputs, and nothing else. It predicts
    all frames of the window; those from `scored_from` on are scored, the given ones included where they are among them.
    Frames are counted from the end of the window whose frames are given.

    Attributes:
        name: also the name of the stored result.
        split: which file of the data set, without `.h5`.
        horizon: T, frames of the window.
        given: frames that the model gets. 2 in arXiv v1, 3 in its journal version, 5 in "Which priors matter?".
        start: first frame of the window. Above 0 the motion is *taken up*: it is not at rest at the first given frame.
        metric: "squared", the mean squared error of a frame (KeyCLD, eq. 16), or "normalised", Σ(x̂ − x)² / Σx² ("Which
            priors matter?").
        thresholds: each scored on its own, the first is the headline. For "squared" in units of ε, the error of the
            validation set's mean image; for "normalised" the numbers themselves.
        scored_from: frames that are predicted but not scored. Above 0, the valid prediction time is counted from there
            and relative to the frames that are scored.
        direction: "forward", the first frames are given; "backward", the last ones are, and the motion is rolled back
            to frame 0. The valid prediction time is then counted from the last frame back.
        trajectories: how many, the first of the file; None for all.
        shown: how many of them keep their pictures for the report.

    Raises:
        KeycldError: no frame is given, nothing is left to predict or to score, or a value is none of those above.
    """

    name: str
    split: str
    horizon: int
    given: int = 2
    start: int = 0
    metric: str = "squared"
    thresholds: tuple[float, ...] = (1.0, 0.25)
    scored_from: int = 0
    direction: str = "forward"
    trajectories: int | None = None
    shown: int = 6

    def __post_init__(self):
        if self.metric not in METRICS:
            raise unknown("metric", self.metric, METRICS)
        if self.direction not in DIRECTIONS:
            raise unknown("direction", self.direction, DIRECTIONS)
        if not 1 <= self.given < self.horizon:
            self._refuse(f"gives {self.given} of {self.horizon} frames: give at least 1 and fewer than all")
        if self.start < 0:
            self._refuse(f"takes recordings up at frame {self.start}: the first frame is 0")
        if not 0 <= self.scored_from < self.horizon:
            self._refuse(
                f"is scored from frame {self.scored_from} on, but its window has {self.horizon} frames: make the "
                "window longer, or score from an earlier frame, not before 0"
            )
        if not self.thresholds or not all(math.isfinite(each) and each > 0 for each in self.thresholds):
            self._refuse(f"has the thresholds {self.thresholds}: give one positive number or more")
        if self.trajectories is not None and self.trajectories < 1:
            self._refuse(f"scores {self.trajectories} trajectories: score at least 1, or None for all")
        if self.shown < 0:
            self._refuse(f"keeps the pictures of {self.shown} trajectories: keep 0 or more")

    def _refuse(self, mistake: str) -> None:
        raise KeycldError(f"protocol '{self.name}' {mistake}.")

    @property
    def backward(self) -> bool:
        """Whether the motion is predicted into the past."""
        return self.direction == "backward"

    @property
    def first_given(self) -> int:
        """Number of the first given frame in the window."""
        return self.horizon - self.given if self.backward else 0

    @property
    def part(self) -> tuple[int, int]:
        """First scored frame of the window and the one after the last, in the order of time."""
        return self.span(self.scored_from, self.horizon)

    @property
    def train_part(self) -> tuple[int, int] | None:
        """Frames from the last given one to the scored part, which models are trained on; None where there are none."""
        return self.span(self.given - 1, self.scored_from) if self.given - 1 < self.scored_from else None

    def span(self, first: int, stop: int) -> tuple[int, int]:
        """Return frames `first` … `stop` − 1, counted from the window's given end, in the order of time."""
        return (self.horizon - stop, self.horizon - first) if self.backward else (first, stop)

    def limit(self, threshold: float, epsilon: float) -> float:
        """Return the error that a threshold stands for, given the validation set's ε."""
        return threshold * epsilon if self.metric == "squared" else threshold

    @property
    def needs(self) -> int:
        """Frames that a recording must have."""
        return self.start + self.horizon
