"""The error of "Which priors matter?", and what predictions without any knowledge score in it."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped, UInt8

# Tables 5 and 6 of the paper hold 10⁷ times the normalised error over a picture's 32 · 32 · 3 numbers.
TABLE_UNITS = 1e7 / 3072
# A frame is predicted validly up to this normalised error.
THRESHOLD = 0.025


def normalised_errors(
    truth: Shaped[np.ndarray, "*frames H W C"], prediction: Shaped[np.ndarray, "*others H W C"]
) -> Float[np.ndarray, "*any"]:
    """Compute Σ (x − x̂)² / Σ x² over pixels and channels of each frame, with x in [0, 1].

    Source: "Which priors matter?" (arXiv 2111.05458), where the valid prediction time ends above 0.025.

    Args:
        truth: x, uint8 or float in [0, 1].
        prediction: x̂, likewise; its leading axes broadcast against those of `truth`.
    """
    x, predicted = _unit(truth), _unit(prediction)
    pixels = (-3, -2, -1)
    squares = np.sum((x - predicted) ** 2, axis=pixels, dtype=np.float64)
    return np.asarray(squares / np.sum(x**2, axis=pixels, dtype=np.float64))


def trivial_scores(
    train: Iterable[UInt8[np.ndarray, "_ T H W 3"]], test: Iterable[UInt8[np.ndarray, "_ T2 H W 3"]]
) -> dict[str, dict[str, Any]]:
    """Score two constant predictions: the mean picture of `train`, and the first frame of each recording of `test`.

    - `normalised_error`: mean over all frames; `table_units`: the same in the units of tables 5 and 6;
    - `below_threshold`: share of the frames up to 0.025;
    - `vpt`: first frame above it, as a part of the recording, mean over recordings.

    Args:
        train: pictures, some recordings at a time.
        test: likewise.
    """
    mean = _mean_picture(train)
    of_mean, of_first = [], []
    for block in test:
        for recording in block:
            of_mean.append(normalised_errors(recording, mean))
            of_first.append(normalised_errors(recording, recording[0]))
    return {"mean_image": _scores(np.stack(of_mean)), "first_frame": _scores(np.stack(of_first))}


def _unit(frames: np.ndarray) -> np.ndarray:
    return frames.astype(np.float32) / np.float32(255.0 if frames.dtype == np.uint8 else 1.0)


def _mean_picture(blocks: Iterable[np.ndarray]) -> Float[np.ndarray, "H W 3"]:
    total, count = np.zeros((), np.uint64), 0
    for block in blocks:
        total = total + block.sum(axis=(0, 1), dtype=np.uint64)
        count += block.shape[0] * block.shape[1]
    return (total / count / 255.0).astype(np.float32)


def _scores(error: Float[np.ndarray, "N T"]) -> dict[str, Any]:
    above = ~(error <= THRESHOLD)
    crossed = np.where(above.any(axis=1), above.argmax(axis=1), error.shape[1])
    return {
        "normalised_error": float(error.mean()),
        "table_units": float(TABLE_UNITS * error.mean()),
        "below_threshold": float(np.mean(~above)),
        "vpt": float(np.mean(crossed / error.shape[1])),
    }
