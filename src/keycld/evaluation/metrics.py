"""Frame errors, the threshold ε and the valid prediction time, for both definitions in the literature.

- `keycld` (eq. 16): mean squared error of a frame against ε, the error of the mean image of the validation
  set.
- `dm` (Botev et al. 2021, "Which priors matter?"): Σ(truth − prediction)² / Σ truth² against 0.025.

In both, a frame whose error is not a number counts as crossed, equality does not, and what happens after
the first crossing does not matter.
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

from keycld._errors import KeycldError

DM_THRESHOLD = 0.025


def _scale(frames: np.ndarray) -> float:
    """What a value of 1 in [0, 1] is in these frames: 255 in uint8, 1 in floats."""
    return 255.0 if frames.dtype == np.uint8 else 1.0


def _flat(frames: np.ndarray) -> np.ndarray:
    """Frames `[T, …]` as float32 rows in [0, 1]."""
    return frames.reshape(len(frames), -1).astype(np.float32) / np.float32(_scale(frames))


def frame_errors(
    truth: Shaped[np.ndarray, "N T H W C"], prediction: Shaped[np.ndarray, "_ _ _ _ _"]
) -> Float[np.ndarray, "N T"]:
    """Mean over pixels and channels of (truth − prediction)², frame by frame; values in [0, 1] squared.

    Either side may be uint8 or float in [0, 1]. One trajectory at a time is held as float32.

    Raises:
        KeycldError: the shapes differ.
    """
    return _each_trajectory(truth, prediction, lambda t, p: _squares(t - p) / t.shape[1])


def relative_errors(
    truth: Shaped[np.ndarray, "N T H W C"], prediction: Shaped[np.ndarray, "_ _ _ _ _"]
) -> Float[np.ndarray, "N T"]:
    """Σ(truth − prediction)² / Σ truth² of each frame, as in "Which priors matter?".

    Raises:
        KeycldError: the shapes differ.
    """
    return _each_trajectory(truth, prediction, lambda t, p: _squares(t - p) / _squares(t))


def _squares(rows: np.ndarray) -> np.ndarray:
    return np.einsum("tp,tp->t", rows, rows).astype(np.float64)


def _each_trajectory(truth: np.ndarray, prediction: np.ndarray, error: Any) -> np.ndarray:
    if truth.shape != prediction.shape:
        raise KeycldError(
            f"truth and prediction need one shape [N, T, H, W, C]; got {truth.shape} and {prediction.shape}."
        )
    # A diverged prediction overflows to inf or gives NaN; both count as crossed.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return np.stack([error(_flat(t), _flat(p)) for t, p in zip(truth, prediction, strict=True)])


def mean_image(images: Shaped[np.ndarray, "N T H W C"]) -> Float[np.ndarray, "H W C"]:
    """The mean over all frames of all trajectories, in [0, 1]; read one trajectory at a time."""
    return _moments(images)[0]


def epsilon(images: Shaped[np.ndarray, "N T H W C"]) -> float:
    """ε: mean squared difference of all frames to their mean image, the threshold of eq. (16).

    It is the lowest error that a static picture can have on these frames, so above ε a prediction is worth
    less than no motion at all. The paper takes the validation set. Good values: 8.8e-4, 1.05e-3 and 1.98e-3
    on the paper's pendulum, cartpole and acrobot.

    Args:
        images: uint8, or float in [0, 1]; read one trajectory at a time.
    """
    mean, mean_square = _moments(images)
    return float(np.mean(mean_square - mean**2))


def _moments(images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and mean square of each pixel, in [0, 1]."""
    total, squares = np.zeros(images.shape[2:]), np.zeros(images.shape[2:])
    for trajectory in images:
        # Over 128 frames, sums of squares of uint8 values are whole numbers below 2²⁴: exact in float32.
        for start in range(0, len(trajectory), 128):
            block = trajectory[start : start + 128].astype(np.float32)
            total += block.sum(axis=0)
            squares += np.einsum("t...,t...->...", block, block)
    scale, count = _scale(images), images.shape[0] * images.shape[1]
    return total / (scale * count), squares / (scale**2 * count)


def valid_prediction_time(
    errors: Float[np.ndarray, "N T"],
    threshold: float,
    *,
    part: tuple[int, int] | None = None,
    backward: bool = False,
) -> Int[np.ndarray, "N"]:
    """VPT in frames: how many frames pass until the error first exceeds the threshold; the whole length if
    never.

    VPT = argminᵢ [error(i) > threshold] (eq. 16). Divide by the number of frames scored to compare horizons.

    Args:
        errors: `[N, T]`, frames in ascending time.
        threshold: ε times a factor, or 0.025 for relative errors.
        part: first frame scored and the one after the last; all by default. Counted from the part's start.
        backward: count from the end of the part toward its start, for predictions into the past.

    Raises:
        KeycldError: the part is empty or reaches beyond the frames.
    """
    start, stop = part or (0, errors.shape[1])
    if not 0 <= start < stop <= errors.shape[1]:
        raise KeycldError(f"a scored part needs 0 ≤ start < stop ≤ {errors.shape[1]}; got {start} to {stop}.")
    scored = errors[:, start:stop]
    if backward:
        scored = scored[:, ::-1]
    crossed = ~(scored <= threshold)  # also true where the error is NaN
    return np.where(crossed.any(axis=1), crossed.argmax(axis=1), scored.shape[1])


def statistics(values: Float[np.ndarray, "n"], *, seed: int = 0) -> dict[str, Any]:
    """Mean, standard deviation (population), median, and a 95 % bootstrap interval of the mean.

    The interval speaks of the trajectories only: it resamples them 2000 times, with the same numbers at
    every call. How much training with another seed would change is another matter.
    """
    random = np.random.default_rng(seed)
    draws = random.integers(len(values), size=(2000, len(values)))
    low, high = np.quantile(values[draws].mean(axis=1), (0.025, 0.975))
    return {
        "mean": float(np.mean(values)),
        "std": float(np.std(values)),
        "median": float(np.median(values)),
        "interval": [float(low), float(high)],
        "n": len(values),
    }
