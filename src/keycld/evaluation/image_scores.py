"""Frame errors of a prediction in both metrics, and what a protocol makes of them."""

from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from keycld.data.describe.normalised_error import TABLE_UNITS
from keycld.evaluation.metrics import ERRORS, frame_errors, statistics, valid_prediction_time
from keycld.evaluation.protocols import Protocol

ERROR_ARRAYS = {"squared": "mse", "normalised": "normalised_error"}
"""Names of stored frame errors by the metric of the protocol."""


def all_errors(
    protocol: Protocol, truth: Shaped[np.ndarray, "N T H W 3"], prediction: Shaped[np.ndarray, "N T H W 3"]
) -> dict[str, Float[np.ndarray, "N T"]]:
    """Compute the frame errors that are stored: `mse` always, and those of the protocol's metric."""
    errors = {"mse": frame_errors(truth, prediction)}
    if protocol.metric != "squared":
        errors[ERROR_ARRAYS[protocol.metric]] = ERRORS[protocol.metric](truth, prediction)
    return errors


def image_scores(
    errors: dict[str, np.ndarray], epsilon: float, protocol: Protocol, *, per_trajectory: bool = False
) -> dict[str, Any]:
    """Compute VPT for each threshold, relative to the scored frames, and mean errors.

    Args:
        errors: from `all_errors`.
        epsilon: ε of the validation set.
        protocol: which frames are scored, and against what.
        per_trajectory: keep the number of frames of each trajectory too.

    Returns:
        `vpt`: by threshold, `statistics` and, if asked for, `frames`; `mse` of the scored part; for the normalised
            metric also `normalised_error` and `table_units`, each of the scored part (`extrapolation`) and
            of the frames from the last given one to it (`train`).
    """
    first, stop = protocol.part
    vpt = {}
    for threshold in protocol.thresholds:
        limit = protocol.limit(threshold, epsilon)
        chosen = errors[ERROR_ARRAYS[protocol.metric]]
        frames = valid_prediction_time(chosen, limit, part=protocol.part, backward=protocol.backward)
        vpt[f"{threshold:g}"] = statistics(frames / (stop - first))
        if per_trajectory:
            vpt[f"{threshold:g}"]["frames"] = frames.tolist()
    scores: dict[str, Any] = {"mse": float(np.mean(errors["mse"][:, first:stop])), "vpt": vpt}
    if protocol.metric == "normalised":
        parts = {"train": protocol.train_part, "extrapolation": protocol.part}
        means = {
            name: float(np.mean(errors["normalised_error"][:, slice(*part)]))
            for name, part in parts.items()
            if part is not None
        }
        scores["normalised_error"] = means
        scores["table_units"] = {name: TABLE_UNITS * mean for name, mean in means.items()}
    return scores
