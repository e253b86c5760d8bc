"""What the errors of a fit say of the noise: its scale, and how long an error lasts."""

import numpy as np
from jaxtyping import Float

# Standard deviations beyond which a correlation is not chance.
_CHANCE = 2.0


def robust_scale(error: Float[np.ndarray, "N T dim"]) -> Float[np.ndarray, "dim"]:
    """Return the standard deviation of the errors of each keypoint, for both of its coordinates."""
    pairs = error.reshape(-1, error.shape[-1] // 2, 2)
    return np.repeat(np.maximum([deviation(pairs[:, k]) for k in range(pairs.shape[1])], 1e-9), 2)


def deviation(errors: Float[np.ndarray, "..."]) -> float:
    """Return the standard deviation of errors of mean zero, in which outliers have little weight.

    Errors beyond three times that of a normal distribution with their median, 1.483 median |e|, count as much as these.
    """
    size = np.abs(errors)
    most = 3 * 1.483 * np.median(size)
    # 0.995 is this mean for a normal distribution.
    return float(np.sqrt(np.mean(np.minimum(size, most) ** 2) / 0.995))


def autocovariance(scores: Float[np.ndarray, "N T"]) -> Float[np.ndarray, "L"]:
    """Return the autocovariance C of errors over time, at lags 0 to L − 1.

    Lags count up to the first whose correlation may be chance (below 2/√n), with Bartlett's weights 1 − k/L over twice
    as many, which keep C positive. Independent errors have L = 1.

    Args:
        scores: weighted errors of one coordinate in N recordings.
    """
    count, length = scores.shape
    most = max(1, length // 4)
    lags = np.array([np.sum(scores[:, : length - k] * scores[:, k:]) for k in range(most)]) / scores.size
    if lags[0] <= 0:
        return lags[:1]
    chance = np.flatnonzero(lags[1:] < _CHANCE * lags[0] / np.sqrt(scores.size))
    first = (int(chance[0]) if chance.size else most - 1) + 1
    width = 1 if first == 1 else min(2 * first, most)
    return lags[:width] * (1 - np.arange(width) / width)


def lagged_products(effect: Float[np.ndarray, "N T P"], covariance: Float[np.ndarray, "L"]) -> np.ndarray:
    """Return Σ over recordings and times s, t of C(|s − t|) gₛ gₜᵀ, the covariance of Σ gₜ eₜ."""
    total = covariance[0] * np.einsum("nti,ntj->ij", effect, effect)
    for k in range(1, min(len(covariance), effect.shape[1])):
        product = covariance[k] * np.einsum("nti,ntj->ij", effect[:, :-k], effect[:, k:])
        total = total + product + product.T
    return total
