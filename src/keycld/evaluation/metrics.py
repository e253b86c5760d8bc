"""Frame errors, the threshold ε, mean images and the valid prediction time, for both definitions in the literature.

- "squared" (KeyCLD, eq. 16): mean squared error of a frame against ε, the error of the validation set's mean image.
- "normalised" (Botev et al. 2021, "Which priors matter?"): Σ(truth − prediction)² / Σ truth² against 0.025.

In both, a frame whose error is not a number counts as crossed, equality does not, and what happens after the first
crossing does not matter.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

from keycld._errors import KeycldError
from keycld.data import normalised_errors


def _scale(frames: np.ndarray) -> float:
    """Return what a value of 1 in [0, 1] is in these frames: 255 in uint8, 1 in floats."""
    return 255.0 if frames.dtype == np.uint8 else 1.0


def _flat(frames: np.ndarray) -> np.ndarray:
    """Return frames `[T, …]` as float32 rows in [0, 1]."""
    return frames.reshape(len(frames), -1).astype(np.float32) / np.float32(_scale(frames))


def frame_errors(
    truth: Shaped[np.ndarray, "N T H W C"], prediction: Shaped[np.ndarray, "_ _ _ _ _"]
) -> Float[np.ndarray, "N T"]:
    """Return the mean over pixels and channels of (truth − prediction)², frame by frame, as in KeyCLD (eq. 16).

    Either side may be uint8 or float in [0, 1]; errors are in [0, 1] squared. One trajectory at a time is held as
    float32. Good values: below ε.

    Raises:
        KeycldError: the shapes differ.
    """
    return _each_trajectory(truth, prediction, _mean_squares)


def relative_errors(
    truth: Shaped[np.ndarray, "N T H W C"], prediction: Shaped[np.ndarray, "_ _ _ _ _"]
) -> Float[np.ndarray, "N T"]:
    """Return Σ(truth − prediction)² / Σ truth² of each frame, the `normalised_errors` of "Which priors matter?".

    Good values: below 0.025.

    Raises:
        KeycldError: the shapes differ.
    """
    return _each_trajectory(truth, prediction, normalised_errors)


ERRORS: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "squared": frame_errors,
    "normalised": relative_errors,
}
"""Frame errors by the name of a protocol's metric."""


def _mean_squares(truth: np.ndarray, prediction: np.ndarray) -> np.ndarray:
    gap = _flat(truth) - _flat(prediction)
    return np.einsum("tp,tp->t", gap, gap).astype(np.float64) / gap.shape[1]


def _each_trajectory(truth: np.ndarray, prediction: np.ndarray, error: Callable) -> np.ndarray:
    if truth.shape != prediction.shape:
        raise KeycldError(
            f"truth and prediction need one shape [N, T, H, W, C]; got {truth.shape} and {prediction.shape}."
        )
    # A diverged prediction overflows to inf or gives NaN; both count as crossed.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return np.stack([error(t, p) for t, p in zip(truth, prediction, strict=True)])


class PixelMoments:
    """Mean and variance of each pixel over frames that come in blocks.

    Attributes:
        trajectories: how many have been added.
    """

    def __init__(self):
        """Begin without frames."""
        self.trajectories = 0
        self._frames, self._scale = 0, 1.0
        self._total: Any = 0.0
        self._squares: Any = 0.0

    def add(self, images: Shaped[np.ndarray, "N T H W C"]) -> None:
        """Add trajectories of frames, all uint8 or all float in [0, 1]; 128 frames at a time are held as floats."""
        self._scale = _scale(images)
        for trajectory in images:
            # Over 128 frames, sums of squares of uint8 values are whole numbers below 2²⁴: exact in float32.
            for first in range(0, len(trajectory), 128):
                block = trajectory[first : first + 128].astype(np.float32)
                self._total = self._total + block.sum(axis=0).astype(np.float64)
                self._squares = self._squares + np.einsum("t...,t...->...", block, block).astype(np.float64)
        self.trajectories += len(images)
        self._frames += images.shape[0] * images.shape[1]

    @property
    def mean(self) -> Float[np.ndarray, "H W C"]:
        """The mean image, in [0, 1]."""
        return self._total / (self._scale * self._frames)

    @property
    def epsilon(self) -> float:
        """ε: mean squared difference of all frames to their mean image, the threshold of eq. (16)."""
        return float(np.mean(self._squares / (self._scale**2 * self._frames) - self.mean**2))


def mean_image(images: Shaped[np.ndarray, "N T H W C"]) -> Float[np.ndarray, "H W C"]:
    """Return the mean over all frames of all trajectories, in [0, 1]."""
    moments = PixelMoments()
    moments.add(images)
    return moments.mean


def epsilon(images: Shaped[np.ndarray, "N T H W C"]) -> float:
    """Return ε: mean squared difference of all frames to their mean image, the threshold of eq. (16).

    It is the lowest error that a static picture can have on these frames, so above ε a prediction is worth less than no
    motion at all. The paper takes the validation set. Good values: 8.8e-4, 1.05e-3 and 1.98e-3 on the paper's pendulum,
    cartpole and acrobot.

    Args:
        images: uint8, or float in [0, 1].
    """
    moments = PixelMoments()
    moments.add(images)
    return moments.epsilon


def valid_prediction_time(
    errors: Float[np.ndarray, "N T"],
    threshold: float,
    *,
    part: tuple[int, int] | None = None,
    backward: bool = False,
) -> Int[np.ndarray, "N"]:
    """Return VPT in frames: how many pass until the error first exceeds the threshold; all of them if it never does.

    VPT = argminᵢ [error(i) > threshold] (KeyCLD, eq. 16; "Which priors matter?", eq. 5). Divide by the number of frames
    scored to compare horizons.

    Args:
        errors: `[N, T]`, frames in ascending time.
        threshold: ε times a factor, or 0.025 for normalised errors.
        part: first frame scored and the one after the last; all by default. Counted from the part's first frame.
        backward: count from the last frame of the part to its first, for predictions into the past. (The released code
            of "Which priors matter?" counts from the far end there; its paper's numbers fit the near end.)

    Raises:
        KeycldError: the part is empty or reaches beyond the frames.
    """
    first, stop = part or (0, errors.shape[1])
    if not 0 <= first < stop <= errors.shape[1]:
        raise KeycldError(f"a scored part needs 0 ≤ start < stop ≤ {errors.shape[1]}; got {first} to {stop}.")
    scored = errors[:, first:stop]
    if backward:
        scored = scored[:, ::-1]
    crossed = ~(scored <= threshold)  # also true where the error is NaN
    return np.where(crossed.any(axis=1), crossed.argmax(axis=1), scored.shape[1])


def statistics(values: Float[np.ndarray, "n"], *, seed: int = 0) -> dict[str, Any]:
    """Compute mean, standard deviation (population), median, and a 95 % bootstrap interval of the mean.

    The interval speaks of the trajectories only: it resamples them 2000 times, with the same numbers at every call. How
    much training with another seed would change is another matter.
    """
    random = np.random.default_rng(seed)
    # One resampling at a time: of 20,000 trajectories, all at once would take 640 MB.
    means = [values[random.integers(len(values), size=len(values))].mean() for _ in range(2000)]
    low, high = np.quantile(means, (0.025, 0.975))
    return {
        "mean": float(np.mean(values)),
        "std": float(np.std(values)),
        "median": float(np.median(values)),
        "interval": [float(low), float(high)],
        "n": len(values),
    }
