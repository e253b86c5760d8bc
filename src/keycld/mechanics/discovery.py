"""Which mechanisms the tracks of parts may belong to: tests of circles, lines and distances."""

import dataclasses
import itertools
import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from keycld._errors import KeycldError
from keycld.mechanics.circle import nearest_circle
from keycld.mechanics.constraints import Constraints
from keycld.mechanics.relation import UNKNOWN, AbstractRelation
from keycld.mechanics.relations.distance_to_point import DistanceToPoint
from keycld.mechanics.relations.fixed_distance import FixedDistance
from keycld.mechanics.relations.on_line import OnLine

# A relation holds if a track deviates from it by less than this share of its extent.
HOLDS = 0.04
# A part says nothing new if another one's angle or place on a line tells its place to within this share of its extent,
# or so many deviations of its noise.
_FOLLOWS, _NOISES = 0.03, 3.0
# A circle or a line of its own explains a part better than a link, which has more numbers, up to so many times its
# error.
_OWN = 1.5
# A circle is more than a line only if it is so many times closer to the track.
_ROUNDER = 4.0
_MOST = 3
"""Parts of a chain."""
# A link is at most so many times as long as the motion of its end, and a joint at most so far along a link.
_LONGEST, _FARTHEST = 3.0, 4.0
_NAMES = {
    ("circle",): ("pendulum", ("ball",)),
    ("line",): ("spring", ("mass",)),
    ("circle", "link"): ("double-pendulum", ("elbow", "tip")),
    ("line", "link"): ("cart-pole", ("cart", "tip")),
}
"""The relation of each part in turn, and the mechanism by name that has them, with its keypoints."""


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A mechanism that may explain the tracks.

    Attributes:
        mechanism: its name; None where it has none.
        constraints: keypoints and relations.
        x: tracks of the keypoints `[T, 2K]`, image-plane units.
        seen: whether all parts are seen whole `[T]`; tracks are interpolated elsewhere.
        residuals: for each relation, how far the track deviates from it, as a share of the track's extent.
    """

    mechanism: str | None
    constraints: Constraints
    x: Float[np.ndarray, "T dim"]
    seen: Bool[np.ndarray, "T"]
    residuals: dict[str, float]

    @property
    def freedom(self) -> int:
        """Degrees of freedom: two for each keypoint, less the constraints."""
        return self.constraints.dimension - self.constraints.count

    @property
    def holds(self) -> bool:
        """Whether all relations hold."""
        return all(residual < HOLDS for residual in self.residuals.values())


@dataclasses.dataclass(frozen=True)
class _Placed:
    """A part with its relation: "circle", "line", "link" or "free", and the place that its next link turns around."""

    kind: str
    residual: float
    track: np.ndarray
    centre: np.ndarray | None


def candidates(
    tracks: Float[np.ndarray, "P T 2"], seen: Bool[np.ndarray, "P T"], areas: Float[np.ndarray, "P"]
) -> list[Candidate]:
    """Return the mechanisms that the tracks of parts may belong to, the likeliest by their geometry first.

    A part whose place follows from the angle, or the place on a line, of another one belongs to it: the rod of a ball,
    its shadow, a spring. Of the parts that are left, the first is on a circle or on a line. Another one is on a circle
    or a line of its own, or at a constant distance from a joint: a point that is fixed to the part before, found with
    the distance. What fits none of these is free. Of all orders of the parts the closest counts.

    Args:
        tracks: of each part, image-plane units.
        seen: whether it is seen whole; other frames do not count.
        areas: of each part; of parts that say the same, the larger one is taken where both are as exact.

    Raises:
        KeycldError: there are no parts.
    """
    if not len(tracks):
        raise KeycldError("no part that moves was found: name the mechanism with --mechanism.")
    own = [_own(track, use) for track, use in zip(tracks, seen, strict=True)]
    order = sorted(range(len(tracks)), key=lambda k: _rank(own[k], tracks[k], seen[k], areas[k]))
    kept: list[int] = []
    for k in order:
        if not any(_follows(tracks[k], own[j][0], tracks[j], seen[k] & seen[j]) for j in kept):
            kept.append(k)
    kept = kept[:_MOST]

    def chained(root: _Placed, places: tuple[int, ...]) -> list[_Placed]:
        chain = [root]
        for last, k in itertools.pairwise(places):
            link = _link(tracks[k], _before(chain, tracks[last]), chain[-1], seen[k] & seen[last])
            chain.append(_preferred(own[k][0], link))
        return chain

    chains = [(places, chained(own[places[0]][0], places)) for places in itertools.permutations(kept)]
    places, best = min(chains, key=lambda each: _cost(each[1]))
    used = list(places)
    all_seen = np.asarray(seen[used].all(axis=0))
    found = [_candidate(best, tracks[used], all_seen)]
    other = own[places[0]][1]
    if math.isfinite(other.residual):
        found.append(_candidate(chained(other, places), tracks[used], all_seen))
    first = best[:1] if len(kept) > 1 else []
    free = [_Placed("free", 0.0, tracks[k], None) for k in places[len(first) :]]
    if any(each.kind != "free" for each in best[len(first) :]):
        found.append(_candidate([*first, *free], tracks[used], all_seen))
    return found


def _cost(chain: list[_Placed]) -> tuple[int, float]:
    """Return the degrees of freedom of a chain, where a relation that does not hold frees one, and its residuals."""
    loose = sum(each.kind == "free" or each.residual >= HOLDS for each in chain)
    return len(chain) + loose, sum(each.residual for each in chain)


def _rank(own: list[_Placed], track: np.ndarray, seen: np.ndarray, area: float) -> tuple[bool, float]:
    """Order parts: those on a circle or a line first, of these the most exact for their motion."""
    best = min(each.residual for each in own)
    exact = max(best, 0.005) / _extent(track[seen]) / math.sqrt(area)
    return best >= HOLDS, exact


def _own(track: np.ndarray, seen: np.ndarray) -> list[_Placed]:
    """Return the relations of a part alone, the likelier first: a circle, a line."""
    points = track[seen]
    extent = _extent(points)
    middle = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
    straight = _spread((points - middle) @ axes[1]) / extent
    # So many points each time, because each number of them needs a program of its own.
    some = points[np.linspace(0, len(points) - 1, 200).astype(int)]
    centre, radius = (np.asarray(part, float) for part in nearest_circle(jnp.asarray(some, jnp.float32)))
    away = np.linalg.norm(points - centre, axis=1)
    round_ = _spread(away - radius) / extent if radius < 20 * extent else math.inf
    line, circle = _Placed("line", straight, track, None), _Placed("circle", round_, track, centre)
    return [line, circle] if straight < _ROUNDER * round_ and straight < HOLDS else [circle, line]


def _preferred(own: _Placed, link: _Placed) -> _Placed:
    """Return a part's own relation, or the link to the part before where that holds and is clearly closer."""
    if own.residual < HOLDS and own.residual < _OWN * link.residual:
        return own
    if link.residual < HOLDS:
        return link
    return dataclasses.replace(own, kind="free", residual=0.0)


def _before(chain: list[_Placed], track: np.ndarray) -> np.ndarray:
    """Return the near end of the last part of a chain: its pivot or joint; without one its own place."""
    centre = chain[-1].centre
    return track if centre is None else centre


def _link(track: np.ndarray, before: np.ndarray, root: _Placed, seen: np.ndarray) -> _Placed:
    """Return a part at a constant distance from a joint of the part before, with the joint's track as its centre."""
    from scipy.optimize import least_squares

    extent = _extent(track[seen])
    turning = root.centre is not None
    arm = root.track - before if turning else np.zeros_like(track)

    def joint(numbers: np.ndarray) -> np.ndarray:
        along, across = numbers
        if not turning:
            return root.track + numbers
        return before + along * arm + across * np.stack([-arm[:, 1], arm[:, 0]], axis=1)

    def off(numbers: np.ndarray) -> np.ndarray:
        return (np.linalg.norm(track - joint(numbers[:2]), axis=1) - numbers[2])[seen]

    best: _Placed | None = None
    for start in ((1.0, 0.0), (2.0, 0.0)) if turning else ((0.0, 0.0),):
        length = float(np.median(np.linalg.norm(track - joint(np.array(start)), axis=1)[seen]))
        fitted = least_squares(off, [*start, length], loss="soft_l1", f_scale=0.02 * extent).x
        sound = abs(fitted[2]) < _LONGEST * extent and (not turning or np.hypot(*fitted[:2]) < _FARTHEST)
        residual = _spread(off(fitted)) / extent if sound else math.inf
        if best is None or residual < best.residual:
            best = _Placed("link", residual, track, joint(fitted[:2]))
    assert best is not None
    return best


def _candidate(chain: list[_Placed], tracks: np.ndarray, seen: np.ndarray) -> Candidate:
    kinds = tuple(each.kind for each in chain)
    mechanism, names = _NAMES.get(kinds, (None, tuple(f"part{k + 1}" for k in range(len(chain)))))
    points, items, residuals = list(tracks), [], {}
    for k, each in enumerate(chain):
        relation: AbstractRelation
        if each.kind == "free":
            continue
        if each.kind == "link":
            assert each.centre is not None
            points[k - 1] = each.centre
            relation, label = FixedDistance(names[k - 1], names[k]), f"fixed_distance {names[k - 1]} {names[k]}"
        elif each.kind == "circle":
            relation, label = DistanceToPoint(names[k], UNKNOWN), f"distance_to_point {names[k]}"
        else:
            relation, label = OnLine(names[k], UNKNOWN), f"on_line {names[k]}"
        items.append(relation)
        residuals[label] = float(each.residual)
    x = np.stack(points, axis=1).reshape(len(points[0]), -1)
    return Candidate(mechanism, Constraints(names, items), x, seen, residuals)


def _follows(track: np.ndarray, other: _Placed, place: np.ndarray, seen: np.ndarray) -> bool:
    """Return whether a part's place is a function of another one's angle or place on a line; else, an affine one."""
    points = place[seen] - place[seen].mean(axis=0)
    if other.residual < HOLDS and other.centre is not None:
        away = place[seen] - other.centre
        angle = np.arctan2(away[:, 1], away[:, 0])
        basis = [np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)]
    elif other.residual < HOLDS:
        along = points @ np.linalg.svd(points, full_matrices=False)[2][0]
        basis = [along, along**2]
    else:
        basis = list(points.T)
    matrix = np.stack([np.ones(len(points)), *basis], axis=1)
    left = track[seen] - matrix @ np.linalg.lstsq(matrix, track[seen], rcond=None)[0]
    # Third differences of independent errors have 20 times their variance.
    noise = _spread(np.diff(track, n=3, axis=0)) / math.sqrt(20)
    return _spread(left) < max(_FOLLOWS * _extent(track[seen]), _NOISES * noise)


def _extent(points: np.ndarray) -> float:
    """Return the radius of gyration of the places."""
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1)))) + 1e-9


def _spread(values: np.ndarray) -> float:
    """Return the standard deviation that nine tenths of the values, or vectors, ask for."""
    off = np.abs(values - np.median(values)) if values.ndim == 1 else np.linalg.norm(values, axis=1)
    return float(np.quantile(off, 0.9)) / 1.64
