"""Discovery of a mechanism: the candidates that the geometry allows, chosen by what their dynamics predict."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import UInt8

from keycld.mechanics import (
    AbstractDisplacement,
    Candidate,
    ConstrainedLagrangian,
    Constraints,
    CoupledMasses,
    MechanicalDynamics,
    Rattle,
    SumPotential,
    candidates,
)
from keycld.models.keycld.identify import ahead, identify
from keycld.models.keycld.tracks import Tracks
from keycld.vision import moving_parts

RIGID = 0.25
"""A part whose length varies by a larger share is not one rigid part."""
GIVEN = 10
"""Frames from which the validation part is predicted."""
PREDICTED, PREDICTED_FREE = 0.25, 0.1
"""A mechanism is identified if this prediction is off by less than this share of the extent of the motion: where each
keypoint has a constraint that holds, which is evidence too, and where a keypoint is free."""
EXPLAINED = 0.3
"""The parts that are followed are at least this share of what moves."""
# Frames in a row that may be unseen, and the fewest of a piece that is fitted, or given and predicted.
_GAP, _LEAST = 2, 4
# A mechanism with more degrees of freedom must predict so many times better.
_BETTER = 1.5
# Below this share of the extent predictions are equally good.
_CLOSE = 0.01


@dataclasses.dataclass(frozen=True)
class Judged:
    """A candidate with its evidence.

    Attributes:
        candidate: keypoints, constraints, and how well they hold.
        error: root mean square error of the predicted validation part, as a share of the extent of the motion; None
            where it was not predicted, because the constraints do not hold.
        chosen: whether it is the answer.
    """

    candidate: Candidate
    error: float | None
    chosen: bool = False


def discover(frames: UInt8[np.ndarray, "T H W 3"], fitted: int, dt: float) -> list[Judged]:
    """Return the mechanisms that the frames of training and validation part may show, as `judge_candidates` does.

    None, if most of what moves belongs to no rigid part: parts are told apart by their colours (`moving_parts`).

    Args:
        frames: consecutive ones.
        fitted: so many of them are the training part.
        dt: seconds between frames.
    """
    parts = [part for part in moving_parts(frames) if part.changes < RIGID]
    if sum(part.area for part in parts) < EXPLAINED:
        return []
    tracks, seen = np.stack([part.track for part in parts]), np.stack([part.seen for part in parts])
    return judge_candidates(candidates(tracks, seen, np.array([part.area for part in parts])), fitted, dt)


def judge_candidates(found: list[Candidate], fitted: int, dt: float) -> list[Judged]:
    """Fit the dynamics of each candidate to the training part, predict the validation part, and choose.

    The law is gravity and viscous friction, with springs where a keypoint slides or is free. Of the candidates whose
    prediction is nearly as good as the best, the one with the fewest degrees of freedom is chosen; none, if no
    prediction comes within a quarter of the extent of the motion, or within a tenth where a keypoint is free.

    Args:
        found: `candidates` of the tracks of training and validation part.
        fitted: frames of the training part.
        dt: seconds between frames.

    Returns:
        The chosen one first, then by the error of the prediction, those whose constraints do not hold at the end.
    """
    judged = [Judged(each, _error(each, fitted, dt) if each.holds else None) for each in found]
    sound = [each for each in judged if each.error is not None and each.error < _limit(each.candidate)]
    if sound:
        limit = max(_CLOSE, _BETTER * min(each.error for each in sound if each.error is not None))
        near = [each for each in sound if each.error is not None and each.error <= limit]
        best = min(near, key=lambda each: each.candidate.freedom)
        judged = [dataclasses.replace(each, chosen=each is best) for each in judged]

    def place(each: Judged) -> tuple[bool, bool, float]:
        return not each.chosen, each.error is None, each.error or max(each.candidate.residuals.values(), default=0.0)

    return sorted(judged, key=place)


def _limit(candidate: Candidate) -> float:
    held = {name for item in candidate.constraints.items for name in item.keypoints}
    return PREDICTED if held == set(candidate.constraints.keypoints) else PREDICTED_FREE


def _error(candidate: Candidate, fitted: int, dt: float) -> float:
    """Return the error of the predicted validation part, as a share of the extent of the motion."""
    first, frames = max(_runs(_with_gaps_closed(candidate.seen)[fitted:]), key=lambda run: run[1], default=(0, 0))
    observed = None if frames < _LEAST else observed_pieces(candidate, fitted, dt)
    if observed is None:
        return float("inf")
    count, length = observed.tracks.x.shape[:2]
    shown = min(frames, length)
    held = candidate.x[fitted + first :][:shown]
    given = min(GIVEN, shown // 2)
    # In the shape of the training part, so that one program serves both.
    padded = np.concatenate([held, np.repeat(held[-1:], length - shown, axis=0)])
    ahead_of = dataclasses.replace(observed.tracks, x=jnp.asarray(np.stack([padded] * count), jnp.float32))
    terms = _forces(candidate.constraints)
    found = identify(observed.dynamics, observed.tracks, pixel=0.0, terms=terms)
    paths = np.asarray(ahead(found.dynamics, ahead_of, given), float)
    off = (paths[0, :shown] - held)[given:]
    error = float(np.sqrt(np.mean(np.sum(off**2, axis=1))) / observed.extent)
    return error if np.isfinite(error) else float("inf")


class Observed(NamedTuple):
    """The pieces of a candidate's tracks that can be fitted.

    Attributes:
        dynamics: without forces yet; unknown numbers of the constraints are where the tracks put them.
        tracks: of the pieces.
        extent: root mean square distance from the mean, image-plane units.
    """

    dynamics: MechanicalDynamics
    tracks: Tracks
    extent: float


def observed_pieces(candidate: Candidate, frames: int, dt: float) -> Observed | None:
    """Return the pieces of the first frames that show all parts whole; None if they are too short.

    A chain's motion is fitted in halves, as the recordings of a clip are: after a while nearby motions part.
    """
    x, seen = candidate.x[:frames], _with_gaps_closed(candidate.seen)[:frames]
    if not seen.any():
        return None
    positions = jnp.asarray(x[seen], jnp.float32)
    constraints = candidate.constraints.located(positions)
    starts, length = pieces(seen, frames if constraints.count < 2 else frames // 2)
    if length < _LEAST:
        return None
    law = ConstrainedLagrangian(
        mass=CoupledMasses.ones(len(constraints.keypoints)),
        potential=SumPotential(jnp.zeros(constraints.dimension), {}),
        input_matrix=None,
        constraint=constraints,
    )
    shared = jnp.mean(jax.vmap(constraints)(positions), axis=0)
    shown = jnp.asarray(np.stack([x[start : start + length] for start in starts]), jnp.float32)
    tracks = Tracks(shown, jnp.zeros((len(starts), 0)), jnp.float32(dt), shared, located=True)
    extent = float(np.sqrt(np.mean(np.sum((x[seen] - x[seen].mean(axis=0)) ** 2, axis=1))))
    return Observed(MechanicalDynamics(law, Rattle(substeps=2)), tracks, extent)


def _with_gaps_closed(seen: np.ndarray) -> np.ndarray:
    """Return which frames are as good as seen: interpolation over a frame or two errs little."""
    closed = seen.copy()
    for first, count in _runs(~seen):
        if count <= _GAP and 0 < first < len(seen) - count:
            closed[first : first + count] = True
    return closed


def pieces(seen: np.ndarray, most: int) -> tuple[list[int], int]:
    """Return the first frames of pieces of one length without an unseen frame, and that length.

    Of all lengths between `most`, or the longest run of seen frames, and half of it, the pieces of this one have the
    most frames.
    """
    runs = _runs(seen)
    most = min(most, max(count for _, count in runs))
    length = max(range(most // 2 + 1, most + 1), key=lambda n: (n * sum(count // n for _, count in runs), n))
    return [first + k * length for first, count in runs for k in range(count // length)], length


def _runs(marked: np.ndarray) -> list[tuple[int, int]]:
    """Return first number and length of each run of marked frames."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked.astype(int), [0]])))
    return [(int(first), int(end - first)) for first, end in edges.reshape(-1, 2)]


def _forces(constraints: Constraints) -> tuple[str, ...]:
    hinges = [item for item in constraints.items if isinstance(item, AbstractDisplacement) and item.normal is None]
    hinged = {name for item in hinges for name in item.keypoints}
    turning = hinged == set(constraints.keypoints) and len(hinges) == constraints.count
    return ("viscous",) if turning else ("springs", "viscous")
