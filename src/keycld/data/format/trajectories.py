"""Trajectories in memory."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Trajectories:
    """N recordings of T frames; `docs/data-format.md` describes the file that holds them.

    Attributes:
        time: float64 [T], seconds, the same for all recordings.
        input: float32, [N, l] if it is constant in a recording, or [N, T, l], held from frame k to k + 1. [N, 0] if
            nothing drives the motion.
        image: uint8 [N, T, H, W, 3]; None if a renderer makes it from the state, or if it was not read.
        state: float64 [N, T, d] or None; ground truth, for evaluation only.
        state_derivative: float64 [N, T, d] or None.
        parameters: arrays [N, ...] by name, constant along a recording.
        attributes: `schema_version`, `system`, `dt`, `state_names`, `units`, `input_names`, `seed`, `generator`,
            `protocol` and further facts about the origin of the data.
    """

    time: np.ndarray
    input: np.ndarray
    image: np.ndarray | None = None
    state: np.ndarray | None = None
    state_derivative: np.ndarray | None = None
    parameters: Mapping[str, np.ndarray] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        """Count the recordings."""
        return len(self.input)

    @property
    def frames(self) -> int:
        """Frames of a recording, T."""
        return len(self.time)

    @property
    def dt(self) -> float:
        """Seconds between frames."""
        return float(self.attributes["dt"])
