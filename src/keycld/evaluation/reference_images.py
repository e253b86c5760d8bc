"""What all protocols on one data set share: the threshold ε and what the trivial predictors know."""

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from keycld.evaluation.geometry import angular, embed, positions
from keycld.evaluation.metrics import PixelMoments
from keycld.evaluation.reading import blocks, coprime, evenly, visited

if TYPE_CHECKING:
    from scipy.spatial import KDTree

    from keycld.data import DataSet

_MOST_TRAJECTORIES = 2_000
_MOST_RETRIEVED = 25_000


@dataclass(frozen=True)
class References:
    """The threshold and the trivial predictors' knowledge.

    Attributes:
        epsilon: ε, from the validation set.
        mean_image: of the training set, `[H, W, 3]` in [0, 1].
        images: training frames `[M, H, W, 3]`, to be retrieved by configuration.
        states: their true states `[M, d]`; None where the data has none, or one number a frame without its rate.
        angles: which positions are angles; None likewise.
        sources: what they were computed from: numbers of trajectories and frames, for the result.
    """

    epsilon: float
    mean_image: Float[np.ndarray, "H W 3"]
    images: UInt8[np.ndarray, "M H W 3"]
    states: Float[np.ndarray, "M d"] | None
    angles: Bool[np.ndarray, "m"] | None
    sources: dict[str, int]

    @functools.cached_property
    def tree(self) -> "KDTree | None":
        """The training frames' true configurations, to find the nearest; None where the data has no states."""
        if self.states is None or self.angles is None:
            return None
        from scipy.spatial import KDTree  # not at every start: it takes most of a second

        return KDTree(embed(positions(self.states), self.angles))

    def retrieve(self, q: Float[np.ndarray, "N T m"]) -> UInt8[np.ndarray, "N T H W 3"]:
        """Return the training frames with the true configurations nearest to the positions `q`."""
        assert self.tree is not None and self.angles is not None
        return self.images[np.asarray(self.tree.query(embed(q, self.angles))[1])]

    def guesses(self, most: int = 2000) -> Float[np.ndarray, "G d"]:
        """Return some of the states, from which a search for a configuration begins."""
        assert self.states is not None
        return self.states[:: max(1, len(self.states) // most)]


def validation_epsilon(data: "DataSet") -> float:
    """Return ε, the error of the validation set's mean image, eq. (16); of 2,000 evenly spread trajectories at most.

    Raises:
        KeycldError: the file is missing, or has neither pictures nor a renderer of ours.
    """
    moments = PixelMoments()
    for _, recordings in blocks(data, "validation", evenly(data.count("validation"), _MOST_TRAJECTORIES)):
        moments.add(_pictures(recordings))
    return moments.epsilon


def references(data: "DataSet") -> References:
    """Read the training and validation sets, a block at a time, for any number of protocols.

    ε and the mean image are those of 2,000 evenly spread trajectories where there are more. The frames to be retrieved
    are all training frames, or about 25,000 spread over those trajectories.

    Raises:
        KeycldError: a file is missing, or has neither pictures nor a renderer of ours.
    """
    threshold, train, counted = validation_epsilon(data), PixelMoments(), data.count("validation")
    about = data.split("train", images=False, rows=slice(0, 1))
    # A state of one number has no rate, so no half of it is a position.
    known = about.state is not None and about.state.shape[-1] > 1 and "units" in about.attributes
    count = data.count("train")
    chosen = evenly(count, _MOST_TRAJECTORIES)
    used = len(range(*chosen.indices(count)))
    step = coprime(-(-used * about.frames // _MOST_RETRIEVED), about.frames)
    images, states = [], []
    for taken, recordings in blocks(data, "train", chosen):
        image = _pictures(recordings)
        train.add(image)
        if known:
            n, t = visited(taken, about.frames, step)
            images.append(image[n, t])
            assert recordings.state is not None
            states.append(recordings.state[n, t])
    return References(
        epsilon=threshold,
        mean_image=train.mean,
        images=np.concatenate(images) if known else np.zeros((0, *train.mean.shape), np.uint8),
        states=np.concatenate(states) if known else None,
        angles=angular(about.attributes) if known else None,
        sources={
            "validation_trajectories": len(range(*evenly(counted, _MOST_TRAJECTORIES).indices(counted))),
            "train_trajectories": train.trajectories,
            "retrieved_frames": sum(map(len, images)),
        },
    )


def _pictures(recordings: Any) -> UInt8[np.ndarray, "N T H W 3"]:
    assert recordings.image is not None
    return recordings.image
