"""Predictors that know nothing, or only the first frames: what a score must be compared with.

A model that loses to one of them has learned no motion that the score can see.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, UInt8

from keycld._errors import KeycldError
from keycld.evaluation.geometry import angular, embed, nearest, positions
from keycld.evaluation.metrics import epsilon, frame_errors, mean_image

if TYPE_CHECKING:
    from keycld.data import DataSet, Trajectories

MEAN_IMAGE = "mean image"
FROZEN_FRAME = "frozen frame"
CONSTANT_ACCELERATION = "constant acceleration"


@dataclass(frozen=True)
class References:
    """What all protocols on one data set share: the threshold and the trivial predictors' knowledge.

    Attributes:
        epsilon: ε, from the validation set.
        mean_image: of the training set, `[H, W, 3]` in [0, 1].
        images: training frames `[M, H, W, 3]`, to be retrieved by configuration.
        states: their true states `[M, d]`; None where the data has none.
        angles: which positions are angles; None likewise.
    """

    epsilon: float
    mean_image: Float[np.ndarray, "H W 3"]
    images: UInt8[np.ndarray, "M H W 3"]
    states: Float[np.ndarray, "M d"] | None
    angles: Bool[np.ndarray, "m"] | None


def references(data: "DataSet") -> References:
    """Read the training and validation sets once, for any number of protocols."""
    train, validation = data.train(), data.validation()
    for name, trajectories in (("train", train), ("validation", validation)):
        if trajectories.image is None:
            raise KeycldError(f"scores need pictures, but {name}.h5 of '{data.folder}' has no /image: draw it first.")
    assert train.image is not None and validation.image is not None
    known = train.state is not None and "units" in train.attributes
    return References(
        epsilon=epsilon(validation.image),
        mean_image=mean_image(train.image),
        images=train.image.reshape(-1, *train.image.shape[2:]),
        states=train.state.reshape(-1, train.state.shape[-1]) if known else None,  # pyright: ignore
        angles=angular(train.attributes) if known else None,
    )


def baseline_errors(
    trajectories: "Trajectories", horizon: int, given: int, shared: References
) -> dict[str, Float[np.ndarray, "N T"]]:
    """Frame errors of each trivial predictor by its name.

    - mean image: the mean of the training frames, for ever.
    - frozen frame: the given frames, then the last of them for ever.
    - constant acceleration, where true states exist: the true positions of the first **three** frames
      continue on a parabola, drawn by retrieving the training frame of the nearest true configuration. It
      is told more than a model (true states, one frame more).
    """
    assert trajectories.image is not None
    truth = trajectories.image[:, :horizon]
    index = np.minimum(np.arange(horizon), given - 1)
    errors = {
        MEAN_IMAGE: frame_errors(truth, np.broadcast_to(shared.mean_image, truth.shape)),
        FROZEN_FRAME: frame_errors(truth, truth[:, index]),
    }
    if trajectories.state is not None and shared.states is not None and shared.angles is not None:
        q = extrapolate(positions(trajectories.state[:, :3]), horizon, shared.angles)
        found = nearest(
            embed(q, shared.angles).reshape(len(q) * horizon, -1),
            embed(positions(shared.states), shared.angles),
        ).reshape(len(q), horizon)
        errors[CONSTANT_ACCELERATION] = np.concatenate(
            [frame_errors(truth[n : n + 1], shared.images[found[n : n + 1]]) for n in range(len(q))]
        )
    return errors


def extrapolate(
    q: Float[np.ndarray, "N 3 m"], length: int, angles: Bool[np.ndarray, "m"]
) -> Float[np.ndarray, "N T m"]:
    """The parabola through three frames: q₀ + k (q₁ − q₀) + ½ k (k − 1)(q₂ − 2q₁ + q₀) at frame k."""
    q = np.where(angles, np.unwrap(q, axis=1), q)
    first, second = q[:, 1] - q[:, 0], q[:, 2] - 2.0 * q[:, 1] + q[:, 0]
    k = np.arange(length)[None, :, None]
    return q[:, :1] + k * first[:, None] + 0.5 * k * (k - 1) * second[:, None]
