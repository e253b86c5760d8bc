"""What predictions that know nothing score, in the units of "Which priors matter?"."""

from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

# Tables 5 and 6 of the paper hold 10⁷ times the normalised error over a picture's 32 · 32 · 3 numbers.
TABLE_UNITS = 1e7 / 3072
THRESHOLD = 0.025


def normalised_errors(
    truth: UInt8[np.ndarray, "T H W 3"], predicted: Float[np.ndarray, "*any H W 3"]
) -> Float[np.ndarray, "T"]:
    """Of each frame, Σ (x − x̂)² / Σ x² over pixels and channels, x in [0, 1]."""
    x = truth.astype(np.float32) / 255.0
    return np.sum((x - predicted) ** 2, axis=(1, 2, 3)) / np.sum(x**2, axis=(1, 2, 3))


def trivial_scores(
    train: UInt8[np.ndarray, "N T H W 3"], test: UInt8[np.ndarray, "M T2 H W 3"]
) -> dict[str, dict[str, Any]]:
    """Scores on `test` of two constant predictions: the mean picture of `train`, and each recording's first frame.

    - `normalised_error`: mean over all frames; `table_units`: the same in the units of tables 5 and 6;
    - `below_threshold`: share of the frames below 0.025;
    - `vpt`: first frame above it, as a part of the recording, mean over recordings.
    """
    mean = (train.mean(axis=(0, 1)) / 255.0).astype(np.float32)
    return {
        "mean_image": _scores([normalised_errors(each, mean[None]) for each in test]),
        "first_frame": _scores([normalised_errors(each, each[:1].astype(np.float32) / 255.0) for each in test]),
    }


def _scores(errors: list[np.ndarray]) -> dict[str, Any]:
    error = np.stack(errors)
    above = error > THRESHOLD
    crossed = np.where(above.any(axis=1), above.argmax(axis=1), error.shape[1])
    return {
        "normalised_error": float(error.mean()),
        "table_units": float(TABLE_UNITS * error.mean()),
        "below_threshold": float(np.mean(~above)),
        "vpt": float(np.mean(crossed / error.shape[1])),
    }
