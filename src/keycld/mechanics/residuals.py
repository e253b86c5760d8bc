"""What the errors of a fit say of the noise: its scale, how long an error lasts, how far it depends on the place."""

import numpy as np
from jaxtyping import Float

# Standard deviations beyond which a correlation is not chance.
_CHANCE = 2.0
# Degree of the polynomials of a keypoint's place, and the mean square below which one is constantly zero.
_DEGREE, _NOTHING = 3, 1e-3
# Sizes of errors that are compared, image-plane units.
_SIZES = np.geomspace(1e-6, 0.1, 400)


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

    Lags count in full up to the first whose correlation may be chance (below 2/√n), and with weights that fall to zero
    over as many more (the flat top of Politis and Romano 1995): a triangle over all of them would take away a part of
    the correlation that is known, and error bars would be up to a tenth too small. Negative parts of the spectrum are
    cut off, so that C stays positive. Independent errors have L = 1.

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
    if first == 1:
        return lags[:1]
    width = min(2 * first, most)
    kept = lags[:width] * np.minimum(1.0, 2.0 - 2.0 * np.arange(width) / width)
    # Of C(−k) = C(k), with zeros beyond.
    spectrum = np.fft.hfft(np.pad(kept, (0, length - width)))
    return kept if np.all(spectrum >= 0) else np.fft.ihfft(np.maximum(spectrum, 0.0)).real


def lagged_products(effect: Float[np.ndarray, "N T P"], covariance: Float[np.ndarray, "L"]) -> np.ndarray:
    """Return Σ over recordings and times s, t of C(|s − t|) gₛ gₜᵀ, the covariance of Σ gₜ eₜ."""
    total = covariance[0] * np.einsum("nti,ntj->ij", effect, effect)
    for k in range(1, min(len(covariance), effect.shape[1])):
        product = covariance[k] * np.einsum("nti,ntj->ij", effect[:, :-k], effect[:, k:])
        total = total + product + product.T
    return total


def places(x: Float[np.ndarray, "N T dim"]) -> Float[np.ndarray, "N T dim B"]:
    """Return errors of keypoints that depend smoothly on where they are: polynomials of the place, mean square 1.

    A keypoint may be off by the same amount whenever it returns to a place: by shades, a shadow, the grid of pixels.

    Args:
        x: positions of K keypoints, image-plane units.
    """
    points = x.reshape(*x.shape[:2], -1, 2)
    columns = []
    for k in range(points.shape[2]):
        around = points[:, :, k] - points[:, :, k].mean(axis=(0, 1))
        first, second = np.moveaxis(around / max(np.sqrt(np.mean(around**2)), 1e-9), -1, 0)
        for power in ((i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)):
            value = first ** power[0] * second ** power[1]
            if (square := np.mean(value**2)) > _NOTHING:
                for d in (2 * k, 2 * k + 1):
                    columns.append(np.zeros(x.shape))
                    columns[-1][..., d] = value / np.sqrt(square)
    return np.stack(columns, axis=-1)


def likely_size(
    score: Float[np.ndarray, "B"], noise: Float[np.ndarray, "B B"], curvature: Float[np.ndarray, "B B"]
) -> float:
    """Return the size s of coefficients c with which scores are most likely: score ~ N(0, noise + s² Q Qᵀ).

    It is 0 if zero may be right: if twice the gain in the logarithm of the likelihood is below 4.

    Args:
        score: Σ Bᵀ e, what errors have in common with each function.
        noise: its covariance if all c are zero.
        curvature: Q, by how much c changes the score.
    """
    values, vectors = np.linalg.eigh(noise)
    sound = values > 1e-9 * values.max(initial=0.0)
    unit = vectors[:, sound] / np.sqrt(values[sound])
    gains, turned = np.linalg.eigh(unit.T @ curvature @ curvature.T @ unit)
    squares = (turned.T @ unit.T @ score) ** 2
    spread = 1 + np.append(0.0, _SIZES**2)[:, None] * np.maximum(gains, 0.0)
    unlikely = np.sum(np.log(spread) + squares / spread, axis=1)
    best = int(np.argmin(unlikely))
    return float(_SIZES[best - 1]) if unlikely[0] - unlikely[best] > _CHANCE**2 else 0.0
