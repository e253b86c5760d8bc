"""Predictors that know nothing, or only the given frames: what a score must be compared with.

A model that loses to one of them has learned no motion that the score can see.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Shaped

from keycld.evaluation.geometry import positions
from keycld.evaluation.protocols import Protocol
from keycld.evaluation.reference_images import References

if TYPE_CHECKING:
    from keycld.data import Trajectories

MEAN_IMAGE = "mean image"
FROZEN_FRAME = "frozen frame"
CONSTANT_ACCELERATION = "constant acceleration"


def baseline_predictions(
    window: "Trajectories", protocol: Protocol, shared: References
) -> Iterator[tuple[str, Shaped[np.ndarray, "N T H W 3"]]]:
    """Yield the name and the frames of each trivial predictor, in the order of time.

    - mean image: the mean of the training frames, always.
    - frozen frame: the given frames, then the one nearest to the predicted ones, always.
    - constant acceleration, where true states exist: the true positions of the **three** frames at the given end
      continue on a parabola; the picture is the training frame of the nearest true configuration. It knows more than a
      model: true states, and one frame more than two.

    Args:
        window: trajectories cut to the protocol's window, with pictures.
        protocol: what is given, and in which direction.
        shared: what the predictors know.
    """
    assert window.image is not None
    # A prediction into the past is one into the future of the reversed motion.
    time = slice(None, None, -1 if protocol.backward else 1)
    truth = window.image[:, time]
    yield MEAN_IMAGE, np.broadcast_to(shared.mean_image, truth.shape)
    yield FROZEN_FRAME, truth[:, np.minimum(np.arange(protocol.horizon), protocol.given - 1)][:, time]
    if window.state is not None and shared.angles is not None and protocol.horizon >= 3:
        q = extrapolate(positions(window.state[:, time][:, :3]), protocol.horizon, shared.angles)
        yield CONSTANT_ACCELERATION, shared.retrieve(q)[:, time]


def extrapolate(
    q: Float[np.ndarray, "N 3 m"], length: int, angles: Bool[np.ndarray, "m"]
) -> Float[np.ndarray, "N T m"]:
    """Continue the parabola through three frames: q₀ + k (q₁ − q₀) + ½ k (k − 1)(q₂ − 2q₁ + q₀) at frame k."""
    q = np.where(angles, np.unwrap(q, axis=1), q)
    first, second = q[:, 1] - q[:, 0], q[:, 2] - 2.0 * q[:, 1] + q[:, 0]
    k = np.arange(length)[None, :, None]
    return q[:, :1] + k * first[:, None] + 0.5 * k * (k - 1) * second[:, None]
