"""Identification of the law of motion from observed keypoints: which forces act, and how strong they are."""

import dataclasses
from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld.mechanics import (
    AbstractPotentialTerm,
    Fitted,
    MechanicalDynamics,
    term_kinds,
    terms_of,
    with_kinds,
    with_terms,
)
from keycld.models.keycld.law_fit import (
    FEW,
    LAST_RESORT,
    cheapest,
    climb,
    fit_from_nothing,
    fit_law,
    followed,
    lagrangian,
    sound,
    with_law,
)
from keycld.models.keycld.selection import PLAIN, WORTH, Tried, select_terms
from keycld.models.keycld.tracks import MISSED, SCARCE, Tracks, extent

# The potential energy of free form stays if without it the error would be larger than with it divided by this.
_LESS = 0.75
# Pixels of error with which a law explains the recordings well.
_GOOD = 0.3
# Fewer motions do not show which are lost.
_SEVERAL = 4


@dataclasses.dataclass(frozen=True)
class Identified:
    """The result of `identify`.

    Attributes:
        dynamics: with the terms that the motion asks for, fitted.
        rms: error of the fitted paths, image-plane units.
        worth: for each term that was tried, the share by which the cost would rise without it.
    """

    dynamics: MechanicalDynamics
    rms: float
    worth: dict[str, float]


_Result = TypeVar("_Result", Fitted, Identified)


def identify(
    dynamics: MechanicalDynamics,
    tracks: Tracks,
    *,
    pixel: float,
    terms: tuple[str, ...] | None = None,
    tried: Tried | None = None,
) -> Identified:
    """Find the terms of V and R that act, their parameters, masses and input matrix, from observed keypoints.

    An affine V alone and all terms together are fitted: first by regression of accelerations (`regress_forces`), then
    through the dynamics to a quarter, half and the whole of the recordings (`fit_motions`). A term is dropped if the
    cost would hardly rise without it: ΔJ = ½ θᵀ S θ, with S the curvature of the cost in the parameters θ of the term,
    all others eliminated. Those of the highest rank are judged first, and the others take over what they can. What is
    left is fitted again, from there and, if this explains the recordings less well than all terms did, from nothing. It
    stays if it is worth more than gravity alone. With `tried.takes`, springs and viscous friction take the place of
    other forces that explain the recordings hardly better, because ΔJ does not tell forces apart that do the same. If
    the result explains the recordings badly, a potential energy of free form is added, unless the kinds are limited.

    Of a few recordings that the result does not follow, pieces are taken in their place (`in_pieces`).

    Args:
        dynamics: V affine; its parameters do not matter.
        tracks: of all recordings.
        pixel: size of a pixel, image-plane units.
        terms: kinds of the terms; None: those that the motion asks for.
        tried: which kinds are tried, and what they must be worth; None: all.
    """
    if terms is not None:
        fitted, _ = in_pieces(lambda pieces: fit_from_nothing(dynamics, terms, pieces), tracks)
        return Identified(fitted.dynamics, float(fitted.rms), {})
    tried = tried or Tried()
    tracks = dataclasses.replace(tracks, among=tried.named)
    return in_pieces(lambda pieces: _judged(dynamics, pieces, pixel, tried), tracks)[0]


def in_pieces(fit: Callable[[Tracks], _Result], tracks: Tracks) -> tuple[_Result, Tracks]:
    """Fit recordings or, of a few that the result misses, the longest pieces that it follows.

    The pieces are halves, quarters, …: motions of a double pendulum that begin nearly alike part after some swings,
    and through a recording of many swings no fit finds its way. If no pieces are followed, the recordings are returned.

    Returns:
        The result of the fit, and what was fitted.
    """
    whole = fit(tracks)
    found, pieces = whole, tracks
    while not found.rms < MISSED * extent(pieces.x):
        halves = pieces.halved()
        if halves is None:
            return whole, tracks
        found, pieces = fit(halves), halves
    return found, pieces


def _judged(dynamics: MechanicalDynamics, tracks: Tracks, pixel: float, tried: Tried) -> Identified:
    """Return the law with the terms that recordings ask for, as `identify` describes it."""
    best = fit_from_nothing(dynamics, (), tracks)
    some = slice(None, None, max(1, len(tracks.x) // FEW))
    everything = _with_everything(best, tracks, some, tried.named, good=_GOOD * pixel)
    left, worth = select_terms(everything, tracks[some], tried) if sound(everything) else (best.dynamics, {})
    kept = tuple(sorted(terms_of(lagrangian(left))))
    if kept:
        near = fit_law(left, tracks[some], everything)
        selected = climb(near.dynamics, tracks)
        if selected.rms > (1 + WORTH) * everything.rms:
            again = fit_from_nothing(dynamics, kept, tracks)
            selected = cheapest([selected, again])
        plain = tuple(kind for kind in PLAIN if kind in tried.named)
        if tried.takes and not set(kept) <= set(plain):
            simple = fit_from_nothing(dynamics, plain, tracks)
            if simple.cost <= (1 + max(map(tried.needed, kept))) * selected.cost:
                selected = simple
        if selected.cost < best.cost / (1 + tried.worth):
            best = selected
    if best.rms > _GOOD * pixel and tried.kinds is None:
        grown = with_kinds(lagrangian(best.dynamics), (LAST_RESORT,), key=jax.random.key(0))
        more = fit_law(with_law(best.dynamics, grown), tracks, best)
        worth[LAST_RESORT] = float((best.cost - more.cost) / more.cost)
        if more.rms < _LESS * best.rms:
            best = more
    return Identified(best.dynamics, float(best.rms), worth)


def _with_everything(affine: Fitted, tracks: Tracks, some: slice, kinds: tuple[str, ...], *, good: float) -> Fitted:
    """Fit the terms of all these kinds to some of the recordings.

    The fit begins from the affine one of all recordings if its error is small, otherwise from nothing; of few
    recordings that it misses from both, because either fit may end anywhere. Where motions have own parameters, it
    begins from the one potential energy that explains most alone, or hardly less and is simpler, with viscous friction
    if this explains more: own parameters follow any law a part of the way, and from there no fit of all terms finds the
    way back. Some anchors with a place for each recording are nearly springs, and a pendulum without friction loses
    motions that have some.
    """
    few = tracks[some]
    if tracks.own is not None:
        energies = [kind for kind in kinds if issubclass(term_kinds()[kind], AbstractPotentialTerm)]
        simplest = sorted(energies, key=lambda kind: term_kinds()[kind].rank)
        alone = [fit_from_nothing(affine.dynamics, each, few) for each in ((), *((kind,) for kind in simplest))]
        best = cheapest(alone)
        near = next((fit for fit in alone if fit.cost <= (1 + WORTH) * best.cost), best)
        friction = tuple(kind for kind in PLAIN if kind in kinds and kind not in energies)
        if friction:
            energy = tuple(terms_of(lagrangian(near.dynamics)))
            near = cheapest([near, fit_from_nothing(affine.dynamics, energy + friction, few)])
        return _fitted_more(near, kinds, few)
    fits = []
    if affine.rms > good:
        fits.append(fit_from_nothing(affine.dynamics, kinds, few))
    if not fits or len(tracks.x) <= SCARCE:
        near = affine._replace(initial=jax.tree.map(lambda part: part[some], affine.initial))
        fits.append(_fitted_more(near, kinds, few))
    return cheapest(fits)


def _fitted_more(fitted: Fitted, kinds: tuple[str, ...], tracks: Tracks) -> Fitted:
    """Fit the terms of a fitted law and those of further kinds together, from where they are."""
    law = lagrangian(fitted.dynamics)
    further = [kind for kind in kinds if kind not in terms_of(law)]
    return fit_law(with_law(fitted.dynamics, with_kinds(law, further, key=jax.random.key(0))), tracks, fitted)


def refit(
    dynamics: MechanicalDynamics, tracks: Tracks, *, tried: Tried | None = None, anew: bool = False
) -> tuple[Fitted, Tracks]:
    """Fit the parameters of given dynamics to keypoints.

    Where some motions were lost or diverged, because the first frames show their velocities too badly for the whole of
    a recording, growing parts are fitted as in `identify`: lost motions say nothing true of the parameters. Motions
    with own parameters, and those of a few recordings, are fitted first, to growing parts and with the given law.

    A potential energy of free form gives way to forces of known kinds, identified anew, where these explain the
    keypoints about as well: errors of earlier keypoints may have hidden them.

    Args:
        dynamics: near the solution.
        tracks: of all recordings.
        tried: judge the terms of V and R again: drop those that are not worth enough, as in `identify`; None: keep all.
        anew: identify the forces anew, for keypoints of more frames; they take the place of the given ones unless they
            explain less.

    Returns:
        The fit, and what was fitted: the recordings, or pieces of a few that the given law does not follow.
    """
    if tried is not None:
        tracks = dataclasses.replace(tracks, among=tried.named)
    # Own parameters and lost motions begin far from where they end, and the law must not follow them there.
    few, begin = len(tracks.x) < _SEVERAL, None
    if few or tracks.own is not None:
        begin, tracks = explain(dynamics, tracks)
    fitted = fit_law(dynamics, tracks, begin)
    if tracks.own is None and (few or not np.all(followed(fitted))):
        fitted = cheapest([fitted, climb(dynamics, tracks)])
    free_form = LAST_RESORT in terms_of(lagrangian(dynamics))
    if tried is not None and (anew or free_form):
        known = identify(dynamics, tracks, pixel=0.0, tried=dataclasses.replace(tried, kinds=tried.named))
        other = fit_law(known.dynamics, tracks)
        if sound(other) and not fitted.rms < (_LESS if free_form else 1.0) * other.rms:
            return other, tracks
    if tried is None or not sound(fitted):
        return fitted, tracks
    if tracks.own is not None:
        fitted = _spared(fitted, tracks, tried.worth)
    left = select_terms(fitted, tracks, tried)[0]
    if terms_of(lagrangian(left)).keys() == terms_of(lagrangian(fitted.dynamics)).keys():
        return fitted, tracks
    simpler = fit_law(left, tracks, fitted)
    if not simpler.cost <= (1 + tried.worth) * fitted.cost:
        simpler = cheapest([simpler, climb(left, tracks)])
    return simpler, tracks


def _spared(fitted: Fitted, tracks: Tracks, worth: float) -> Fitted:
    """Return the fit without the terms whose part own parameters take, which `select_terms` does not see.

    Its quadratic model holds for small changes. The place of a recording may move far: next to a fixed point outside a
    line, for example, each recording has a spring of its own softness. From such places no fit finds the way back, so
    the other terms are fitted from nothing too.
    """
    kinds = terms_of(lagrangian(fitted.dynamics))
    for kind in sorted(kinds, key=lambda kind: kinds[kind].rank, reverse=True):
        law = lagrangian(fitted.dynamics)
        terms = {name: term for name, term in terms_of(law).items() if name != kind}
        simpler = fit_law(with_law(fitted.dynamics, with_terms(law, terms)), tracks, fitted)
        most = (1 + worth) * fitted.cost
        if not (sound(simpler) and simpler.cost <= most):
            simpler = fit_from_nothing(fitted.dynamics, tuple(terms), tracks)
        if sound(simpler) and simpler.cost <= most:
            fitted = simpler
    return fitted


def evidence(dynamics: MechanicalDynamics, tracks: Tracks, *, pixel: float, tried: Tried) -> dict[str, float]:
    """Return the worth of each kind of force that is tried: by which share the cost rises without it, as in `identify`.

    Args:
        dynamics: identified ones; their masses and pivots are where the fit begins.
        tracks: of all recordings.
        pixel: size of a pixel, image-plane units.
        tried: as in `identify`.
    """
    tracks = dataclasses.replace(tracks, among=tried.named)
    some = slice(None, None, max(1, len(tracks.x) // FEW))
    alone = fit_from_nothing(dynamics, (), tracks)
    everything = _with_everything(alone, tracks, some, tried.named, good=_GOOD * pixel)
    return select_terms(everything, tracks[some], tried)[1] if sound(everything) else {}


def explain(dynamics: MechanicalDynamics, tracks: Tracks) -> tuple[Fitted, Tracks]:
    """Fit the motions of given dynamics to keypoints; nothing but their initial states is free.

    Returns:
        The fit, and what was fitted: the recordings, or pieces of a few (`in_pieces`).
    """
    return in_pieces(lambda pieces: climb(dynamics, pieces, _all_fixed(dynamics)), tracks)


def ahead(dynamics: MechanicalDynamics, tracks: Tracks, given: int) -> jax.Array:
    """Return the motions `[N, T, 2K]` of given dynamics that fit the first frames of keypoint tracks alone."""
    return fit_law(dynamics, tracks, frames=given, active=_all_fixed(dynamics)).paths


def _all_fixed(dynamics: MechanicalDynamics) -> MechanicalDynamics:
    """Return what tells a fit that none of the parameters are free: zeros."""
    return jax.tree.map(lambda leaf: jnp.zeros_like(leaf) if eqx.is_inexact_array(leaf) else leaf, dynamics)
