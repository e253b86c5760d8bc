"""Keypoints that a model observes next to the true states, and what the probe makes of them."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from keycld.data.export.tracks import KeypointTracks
from keycld.evaluation.acceleration import acceleration_error
from keycld.evaluation.friction import friction_rates
from keycld.evaluation.outcome import keypoint_names
from keycld.evaluation.predicting import observe
from keycld.evaluation.probe import fit_probe, probe_scores
from keycld.evaluation.reading import blocks, coprime, evenly, visited
from keycld.evaluation.reference_images import References
from keycld.models.base import HasKeypoints, HasLagrangian
from keycld.systems import AbstractSystem, get, names

if TYPE_CHECKING:
    from keycld.data import DataSet

_FRAMES = 1000
_MOST_TRAJECTORIES = 2000


def observed_states(
    model: HasKeypoints, data: "DataSet", split: str, trajectories: int | None = None
) -> tuple[Float[np.ndarray, "M K 2"], Float[np.ndarray, "M d"]]:
    """Return keypoints observed in about a thousand frames and the true states there.

    Args:
        model: whose keypoints.
        data: the data set; it must have states.
        split: which file.
        trajectories: how many of it, the first; all by default. The frames are spread over them and over all times.
    """
    frames = data.split(split, images=False, rows=slice(0, 1)).frames
    count = data.count(split) if trajectories is None else min(trajectories, data.count(split))
    rows = evenly(count, _MOST_TRAJECTORIES)
    rows = slice(0, count, rows.step)
    step = coprime(max(1, len(range(0, count, rows.step)) * frames // _FRAMES), frames)
    images, states = [], []
    for taken, recordings in blocks(data, split, rows):
        assert recordings.image is not None and recordings.state is not None
        n, t = visited(taken, frames, step)
        images.append(recordings.image[n, t])
        states.append(recordings.state[n, t])
    return observe(model, np.concatenate(images))[0], np.concatenate(states)


def observed_tracks(model: HasKeypoints, data: "DataSet", split: str) -> KeypointTracks:
    """Return the keypoints that a model observes in every frame of a file, with the inputs.

    Args:
        model: whose keypoints.
        data: the data set.
        split: which file.
    """
    found, inputs = [], []
    for _, recordings in blocks(data, split):
        image, u = recordings.image, recordings.input
        assert image is not None
        keypoints = observe(model, image.reshape(-1, *image.shape[2:]))[0]
        found.append(keypoints.reshape(*image.shape[:2], -1, 2))
        inputs.append(u if u.ndim == 3 else np.repeat(u[:, None], image.shape[1], axis=1))
    x = np.concatenate(found)
    names = keypoint_names(data.keypoints, x.shape[2])
    pushed = tuple(name.replace(" ", "_") for name in data.input_names)
    return KeypointTracks(names, x, np.concatenate(inputs), float(data.dt), pushed)


def probed_system(data: "DataSet", shared: References, split: str) -> AbstractSystem | None:
    """Return the system whose landmarks a probe is fitted to.

    None where it is unknown, or where `split` or the files that the probe needs have no states.
    """
    if shared.states is None or data.system not in names():
        return None
    if any(data.split(name, images=False, rows=slice(0, 1)).state is None for name in ("validation", split)):
        return None
    system = get(data.system)
    return system if system.keypoints and not system.parameters_differ else None


def score_states(
    model: HasKeypoints,
    data: "DataSet",
    system: AbstractSystem,
    shared: References,
    scored: tuple[str, int | None],
    rolled: tuple[np.ndarray, np.ndarray],
) -> tuple[dict[str, Any], dict[str, np.ndarray], int]:
    """Fit a probe on validation frames and score it on others.

    Args:
        model: whose keypoints.
        data: the data set.
        system: that moves, from `probed_system`.
        shared: its states are where the search for a configuration begins.
        scored: split, and how many of its trajectories.
        rolled: predicted keypoints `[N, T, K, 2]` and true states `[N, T, d]`.

    Returns:
        scores and curves of `probe_scores`, with `acceleration` of `acceleration_error` and `friction` of
        `friction_rates`, and the number of frames that passed through the encoder.
    """
    assert shared.angles is not None
    fit, observed = observed_states(model, data, "validation"), observed_states(model, data, *scored)
    probe = fit_probe(system, *fit, shared.guesses(), shared.angles)
    scores, curves = probe_scores(probe, fit, observed, rolled)
    if isinstance(model, HasLagrangian):
        scores["acceleration"] = acceleration_error(model, probe, fit, data, scored[0])
        scores["friction"] = friction_rates(model, system, fit, rolled[1].reshape(-1, rolled[1].shape[-1]))
    return scores, curves, len(fit[0]) + len(observed[0])
