"""Identification of the law of motion from observed keypoints: which forces act, and how strong they are."""

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from keycld.mechanics import (
    AbstractDissipationTerm,
    AbstractPotentialTerm,
    ConstrainedLagrangian,
    Fitted,
    MechanicalDynamics,
    Own,
    fit_motions,
    moved,
    regress_forces,
    rough_states,
    term_kinds,
    terms_of,
    with_kinds,
    with_terms,
)

# A term stays if without it the cost of the fit would rise by this share.
WORTH = 0.2
# Share by which masses may follow when a term is dropped, for that same cost.
_FOLLOW = 0.2
# The potential energy of free form stays if without it the error would be larger than with it divided by this.
_LAST_RESORT, _LESS = "perceptron", 0.75
# What a mechanism has before other forces are suspected.
_PLAIN = ("springs", "viscous")
# About how many recordings all terms together are fitted to.
_FEW = 50
# Pixels of error with which a law explains the recordings well.
_GOOD = 0.3
# A motion whose error is so many times the median has been lost: it began in a wrong state. Fewer motions than the
# second number do not show it.
_LOST, _SEVERAL = 5.0, 4
# Share of the motion that a law may miss of the recordings that it was fitted to.
MISSED = 0.2
# Fits to up to so many recordings begin with short parts. Halves of them are fitted where the whole is missed, while
# constant accelerations miss this share of the motion in halves, and these have so many frames: a law must explain more
# than parabolas can.
_SCARCE, _CURVED, _SHORTEST = 32, 2 * MISSED, 16
# Compiled once for each structure of the law.
_fit = eqx.filter_jit(fit_motions)


@dataclasses.dataclass(frozen=True)
class Tracks:
    """Keypoints observed in recordings, and what a fit to them needs.

    Attributes:
        x: observed keypoints `[N, T, 2K]`.
        u: inputs `[N, l]` or `[N, T, l]`.
        dt: seconds between frames.
        constants: values of Φ that all recordings share; None: each recording has its own.
        located: whether unknown numbers of the constraints stay where the positions alone put them; otherwise they are
            fitted with the dynamics.
        own: first guess and prior of the parameters that differ by recording; None: there are none.
        among: kinds of forces that a compiled fit to few recordings has, acting or not, so that one serves all laws
            with some of them: it is compiled for tens of seconds and runs for one.
    """

    x: jax.Array
    u: jax.Array
    dt: jax.Array
    constants: jax.Array | None
    located: bool = False
    own: Own | None = None
    among: tuple[str, ...] = ()

    def __getitem__(self, recordings: slice) -> "Tracks":
        """Return some of the recordings."""
        own = self.own
        if own is not None:
            own = own._replace(numbers=own.numbers[recordings], expected=own.expected[recordings])
        return dataclasses.replace(self, x=self.x[recordings], u=self.u[recordings], own=own)

    def sharing(self, tried: "Tried | None") -> "Tracks":
        """Return the same with the kinds that are tried in `among`; None: none are."""
        return self if tried is None else dataclasses.replace(self, among=kinds_tried(tried.kinds))

    def halved(self) -> "Tracks | None":
        """Return both halves of each recording; None of many recordings, and where parabolas nearly explain halves."""
        count, length, dim = self.x.shape
        half = length // 2
        if self.own is not None or 2 * count > _SCARCE or half < _SHORTEST:
            return None
        halves = self.x[:, length - 2 * half :].reshape(2 * count, half, dim)
        if _rms(halves - nearest_polynomials(halves, 2)) < _CURVED * _extent(halves):
            return None
        if self.u.ndim == 2:
            u = jnp.repeat(self.u, 2, axis=0)
        else:
            u = self.u[:, length - 2 * half : length].reshape(2 * count, half, self.u.shape[-1])
        return dataclasses.replace(self, x=halves, u=u)


@dataclasses.dataclass(frozen=True)
class Tried:
    """Which forces `identify` tries.

    Attributes:
        kinds: of the terms; None: all but the last resort.
        worth: a term stays if without it the cost of the fit would rise by this share.
        takes: each friction must take energy next to the others too, not only in their place; and other forces must
            explain more than springs and viscous friction do.
        located: pivots that the positions determine alone, because they span 1.5 rad, are not fitted with the dynamics.
            A real mechanism deviates from every law by more than from its circle, and would pull the pivot away.
    """

    kinds: tuple[str, ...] | None = None
    worth: float = WORTH
    takes: bool = False
    located: bool = False


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


def in_pieces(fit: Callable[[Tracks], _Result], tracks: Tracks) -> tuple[_Result, Tracks]:
    """Fit recordings or, of a few that the result misses, the longest pieces that it follows.

    The pieces are halves, quarters, …: motions of a double pendulum that begin nearly alike part after some swings,
    and through a recording of many swings no fit finds its way. If no pieces are followed, the recordings are returned.

    Returns:
        The result of the fit, and what was fitted.
    """
    whole = fit(tracks)
    found, pieces = whole, tracks
    while not found.rms < MISSED * _extent(pieces.x):
        halves = pieces.halved()
        if halves is None:
            return whole, tracks
        found, pieces = fit(halves), halves
    return found, pieces


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
        fitted, _ = in_pieces(lambda pieces: _identified(dynamics, terms, pieces), tracks)
        return Identified(fitted.dynamics, float(fitted.rms), {})
    tried = tried or Tried()
    tracks = tracks.sharing(tried)
    return in_pieces(lambda pieces: _judged(dynamics, pieces, pixel, tried), tracks)[0]


def _judged(dynamics: MechanicalDynamics, tracks: Tracks, pixel: float, tried: Tried) -> Identified:
    """Return the law with the terms that recordings ask for, as `identify` describes it."""
    best = _identified(dynamics, (), tracks)
    some = slice(None, None, max(1, len(tracks.x) // _FEW))
    everything = _with_everything(best, tracks, some, tried.kinds, good=_GOOD * pixel)
    left, worth = _selected(everything, tracks[some], tried) if _sound(everything) else (best.dynamics, {})
    kept = tuple(sorted(terms_of(_lagrangian(left))))
    if kept:
        near = _fitted(left, tracks[some], everything)
        selected = _climb(near.dynamics, tracks)
        if selected.rms > (1 + WORTH) * everything.rms:
            again = _identified(dynamics, kept, tracks)
            selected = _cheapest([selected, again])
        plain = tuple(kind for kind in _PLAIN if kind in kinds_tried(tried.kinds))
        if tried.takes and not set(kept) <= set(plain):
            simple = _identified(dynamics, plain, tracks)
            if simple.cost <= (1 + tried.worth) * selected.cost:
                selected = simple
        if selected.cost < best.cost / (1 + tried.worth):
            best = selected
    if best.rms > _GOOD * pixel and tried.kinds is None:
        grown = with_kinds(_lagrangian(best.dynamics), (_LAST_RESORT,), key=jax.random.key(0))
        more = _fitted(_with_law(best.dynamics, grown), tracks, best)
        worth[_LAST_RESORT] = float((best.cost - more.cost) / more.cost)
        if more.rms < _LESS * best.rms:
            best = more
    return Identified(best.dynamics, float(best.rms), worth)


def _identified(dynamics: MechanicalDynamics, kinds: tuple[str, ...], tracks: Tracks) -> Fitted:
    """Fit an affine V with terms of these kinds, from nothing.

    With own parameters the fit begins from zero forces too: a regression takes all masses for the same.
    """
    law = with_kinds(_affine(_lagrangian(dynamics)), kinds, key=jax.random.key(0))
    x = tracks.x if tracks.own is None else jax.vmap(moved)(tracks.x, tracks.own.numbers[:, :2])
    regressed = regress_forces(law, free_leaves(law), x, tracks.u, tracks.dt)
    begins = (regressed,) if tracks.own is None else (regressed, law)
    return _cheapest(_climb(_with_law(dynamics, each), tracks) for each in begins)


def _cheapest(fits: Iterable[Fitted]) -> Fitted:
    """Return the fit of least cost; one that diverged has none."""
    return min(fits, key=lambda fitted: float(jnp.nan_to_num(fitted.cost, nan=jnp.inf)))


def _with_everything(
    affine: Fitted, tracks: Tracks, some: slice, tried: tuple[str, ...] | None, *, good: float
) -> Fitted:
    """Fit all terms that are tried to some of the recordings.

    The fit begins from the affine one of all recordings if its error is small, otherwise from nothing; of few
    recordings that it misses from both, because either fit may end anywhere. Where motions have own parameters, it
    begins from the one potential energy that explains most alone: own parameters follow any law a part of the way, and
    from there no fit of all terms finds the way back.
    """
    kinds, few = kinds_tried(tried), tracks[some]
    if tracks.own is not None:
        energies = [kind for kind in kinds if issubclass(term_kinds()[kind], AbstractPotentialTerm)]
        alone = _cheapest(_identified(affine.dynamics, each, few) for each in ((), *((kind,) for kind in energies)))
        return _fitted_more(alone, kinds, few)
    fits = []
    if affine.rms > good:
        fits.append(_identified(affine.dynamics, kinds, few))
    if not fits or len(tracks.x) <= _SCARCE:
        near = affine._replace(initial=jax.tree.map(lambda part: part[some], affine.initial))
        fits.append(_fitted_more(near, kinds, few))
    return _cheapest(fits)


def _fitted_more(fitted: Fitted, kinds: tuple[str, ...], tracks: Tracks) -> Fitted:
    """Fit the terms of a fitted law and those of further kinds together, from where they are."""
    law = _lagrangian(fitted.dynamics)
    further = [kind for kind in kinds if kind not in terms_of(law)]
    return _fitted(_with_law(fitted.dynamics, with_kinds(law, further, key=jax.random.key(0))), tracks, fitted)


def kinds_tried(tried: tuple[str, ...] | None) -> tuple[str, ...]:
    """Return the kinds that are tried, of `Tried.kinds`: by default all but the last resort."""
    return tuple(kind for kind, term in term_kinds().items() if (term.tried if tried is None else kind in tried))


def _climb(dynamics: MechanicalDynamics, tracks: Tracks, active: Any = None) -> Fitted:
    """Fit a quarter, half and the whole of the recordings, each from the result of the last; of a few in eighths.

    A motion that a longer part loses among many does not lead the law away.
    """
    length, fitted = tracks.x.shape[1], None
    for eighths in range(1, 8) if len(tracks.x) <= _SCARCE else (2, 4):
        fitted = _fitted(dynamics, tracks, fitted, length * eighths // 8, 8, active)
        dynamics = fitted.dynamics
    return _fitted(dynamics, tracks, fitted, active=active)


def refit(dynamics: MechanicalDynamics, tracks: Tracks, *, tried: Tried | None = None) -> tuple[Fitted, Tracks]:
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

    Returns:
        The fit, and what was fitted: the recordings, or pieces of a few that the given law does not follow.
    """
    tracks = tracks.sharing(tried)
    # Own parameters and lost motions begin far from where they end, and the law must not follow them there.
    few, begin = len(tracks.x) < _SEVERAL, None
    if few or tracks.own is not None:
        begin, tracks = explain(dynamics, tracks)
    fitted = _fitted(dynamics, tracks, begin)
    # Errors of a motion that diverged are no numbers.
    lost = few or not jnp.max(fitted.errors) <= _LOST * jnp.median(fitted.errors)
    if tracks.own is None and lost:
        fitted = _cheapest([fitted, _climb(dynamics, tracks)])
    if tried is not None and _LAST_RESORT in terms_of(_lagrangian(dynamics)):
        known = identify(dynamics, tracks, pixel=0.0, tried=dataclasses.replace(tried, kinds=kinds_tried(tried.kinds)))
        simpler = _fitted(known.dynamics, tracks)
        if _sound(simpler) and not fitted.rms < _LESS * simpler.rms:
            return simpler, tracks
    if tried is None or not _sound(fitted):
        return fitted, tracks
    if tracks.own is not None:
        fitted = _spared(fitted, tracks, tried.worth)
    left = _selected(fitted, tracks, tried)[0]
    if terms_of(_lagrangian(left)).keys() == terms_of(_lagrangian(fitted.dynamics)).keys():
        return fitted, tracks
    return _fitted(left, tracks, fitted), tracks


def _spared(fitted: Fitted, tracks: Tracks, worth: float) -> Fitted:
    """Return the fit without the terms whose part own parameters take, which `_selected` does not see.

    Its quadratic model holds for small changes. The place of a recording may move far: next to a fixed point outside a
    line, for example, each recording has a spring of its own softness. From such places no fit finds the way back, so
    the other terms are fitted from nothing too.
    """
    kinds = terms_of(_lagrangian(fitted.dynamics))
    for kind in sorted(kinds, key=lambda kind: kinds[kind].rank, reverse=True):
        law = _lagrangian(fitted.dynamics)
        terms = {name: term for name, term in terms_of(law).items() if name != kind}
        simpler = _fitted(_with_law(fitted.dynamics, with_terms(law, terms)), tracks, fitted)
        most = (1 + worth) * fitted.cost
        if not (_sound(simpler) and simpler.cost <= most):
            simpler = _identified(fitted.dynamics, tuple(terms), tracks)
        if _sound(simpler) and simpler.cost <= most:
            fitted = simpler
    return fitted


def follow(dynamics: MechanicalDynamics, tracks: Tracks) -> Fitted:
    """Fit given dynamics to growing parts of keypoint tracks, from the initial states that the first frames show."""
    return _climb(dynamics, tracks)


def evidence(dynamics: MechanicalDynamics, tracks: Tracks, *, pixel: float, tried: Tried) -> dict[str, float]:
    """Return the worth of each kind of force that is tried: by which share the cost rises without it, as in `identify`.

    Args:
        dynamics: identified ones; their masses and pivots are where the fit begins.
        tracks: of all recordings.
        pixel: size of a pixel, image-plane units.
        tried: as in `identify`.
    """
    tracks = tracks.sharing(tried)
    some = slice(None, None, max(1, len(tracks.x) // _FEW))
    alone = _identified(dynamics, (), tracks)
    everything = _with_everything(alone, tracks, some, tried.kinds, good=_GOOD * pixel)
    return _selected(everything, tracks[some], tried)[1] if _sound(everything) else {}


def explain(dynamics: MechanicalDynamics, tracks: Tracks) -> tuple[Fitted, Tracks]:
    """Fit the motions of given dynamics to keypoints; nothing but their initial states is free.

    Returns:
        The fit, and what was fitted: the recordings, or pieces of a few (`in_pieces`).
    """
    still = jax.tree.map(lambda leaf: jnp.zeros_like(leaf) if eqx.is_inexact_array(leaf) else leaf, dynamics)
    return in_pieces(lambda pieces: _climb(dynamics, pieces, still), tracks)


def ahead(dynamics: MechanicalDynamics, tracks: Tracks, given: int) -> jax.Array:
    """Return the motions `[N, T, 2K]` of given dynamics that fit the first frames of keypoint tracks alone."""
    still = jax.tree.map(lambda leaf: jnp.zeros_like(leaf) if eqx.is_inexact_array(leaf) else leaf, dynamics)
    return _fitted(dynamics, tracks, frames=given, active=still).paths


def _fitted(
    dynamics: MechanicalDynamics,
    tracks: Tracks,
    begin: Fitted | None = None,
    frames: int | None = None,
    iterations: int = 30,
    active: Any = None,
) -> Fitted:
    if active is None:
        active = _active(dynamics, tracks.located)
    own = tracks.own
    if own is not None and begin is not None and begin.own is not None:
        own = own._replace(numbers=begin.own)
    absent: list[str] = []
    if own is None and len(tracks.x) < 2 * _FEW and _LAST_RESORT not in terms_of(_lagrangian(dynamics)):
        absent = [kind for kind in tracks.among if kind not in terms_of(_lagrangian(dynamics))]
    whole, active = _with_idle(dynamics, active, absent) if absent else (dynamics, active)
    fitted = _fit(
        whole,
        free_leaves(whole),
        tracks.x,
        tracks.u,
        tracks.dt,
        active=active,
        constants=tracks.constants,
        initial=rough_states(tracks.x, tracks.dt) if begin is None else begin.initial,
        own=own,
        frames=jnp.array(tracks.x.shape[1] if frames is None else frames),
        iterations=jnp.array(iterations),
    )
    return _without_idle(fitted, absent) if absent else fitted


def _with_idle(dynamics: MechanicalDynamics, active: Any, kinds: Sequence[str]) -> tuple[MechanicalDynamics, Any]:
    """Return dynamics with further terms that do not act, and what a fit changes of them: no number of these terms."""
    whole = with_kinds(_lagrangian(dynamics), kinds, key=jax.random.key(0))
    idle = {kind: jax.tree.map(jnp.zeros_like, term) for kind, term in terms_of(whole).items() if kind in kinds}
    law = _lagrangian(active)
    return _with_law(dynamics, whole), _with_law(active, with_terms(law, terms_of(law) | idle))


def _without_idle(fitted: Fitted, kinds: Sequence[str]) -> Fitted:
    law = _lagrangian(fitted.dynamics)
    left = with_terms(law, {kind: term for kind, term in terms_of(law).items() if kind not in kinds})
    leaves = jax.tree_util.tree_leaves_with_path(eqx.filter(fitted.dynamics, free_leaves(fitted.dynamics)))
    kept = np.concatenate([np.full(leaf.size, _owner(path, kinds) is None) for path, leaf in leaves])
    return fitted._replace(dynamics=_with_law(fitted.dynamics, left), curvature=fitted.curvature[np.ix_(kept, kept)])


def _active(dynamics: MechanicalDynamics, located: bool) -> Any:
    """Return 1 for each number that a fit changes, 0 for those of the constraints if they are located."""

    def active(path: Any, leaf: Any) -> Any:
        stays = located and ".constraint_function" in jax.tree_util.keystr(path)
        return (jnp.zeros_like if stays else jnp.ones_like)(leaf) if eqx.is_inexact_array(leaf) else leaf

    return jax.tree_util.tree_map_with_path(active, dynamics)


def _with_law(dynamics: MechanicalDynamics, law: ConstrainedLagrangian) -> MechanicalDynamics:
    return eqx.tree_at(lambda d: d.law, dynamics, law)


def _rms(x: jax.Array) -> float:
    return float(jnp.sqrt(jnp.mean(x**2)))


def _extent(x: jax.Array) -> float:
    """Return the root mean square of motions `[N, T, 2K]` around the mean position of each."""
    return _rms(x - jnp.mean(x, axis=1, keepdims=True))


def nearest_polynomials(paths: jax.Array, degree: int) -> jax.Array:
    """Return the nearest polynomials in time to paths `[N, T, …]`."""
    powers = np.vander(np.linspace(-1, 1, paths.shape[1]), degree + 1)
    projection = jnp.asarray(powers @ np.linalg.pinv(powers), paths.dtype)
    return jnp.einsum("st,nt...->ns...", projection, paths, precision="highest")


def _owner(path: Any, kinds: Iterable[str]) -> str | None:
    """Return the kind of the term that a leaf belongs to."""
    name = jax.tree_util.keystr(path)
    return next((kind for kind in kinds if f"terms['{kind}']" in name), None)


def _lagrangian(dynamics: MechanicalDynamics) -> ConstrainedLagrangian:
    assert isinstance(dynamics.law, ConstrainedLagrangian)
    return dynamics.law


def _affine(law: ConstrainedLagrangian) -> ConstrainedLagrangian:
    """Return the law with V = 0, R = 0 and g = 0, all affine."""
    zero = jax.tree.map(lambda leaf: jnp.zeros_like(leaf) if eqx.is_inexact_array(leaf) else leaf, law)
    return with_terms(
        ConstrainedLagrangian(law.mass, zero.potential, zero.input_matrix, law.constraint_function, zero.dissipation),
        {},
    )


def free_leaves(dynamics: Any) -> Any:
    """Return which leaves are fitted: all but the perceptron of g, which has thousands of weights and little to say."""

    def free(path: Any, leaf: Any) -> bool:
        return eqx.is_inexact_array(leaf) and "input_matrix.perceptron" not in jax.tree_util.keystr(path)

    return jax.tree_util.tree_map_with_path(free, dynamics)


def _selected(fitted: Fitted, tracks: Tracks, tried: Tried) -> tuple[MechanicalDynamics, dict[str, float]]:
    """Return the dynamics with the terms that are worth their parameters alone, and the worth of all terms.

    Its parameters have taken over what they can. A dissipation that gives energy on average, in place of all others, is
    worth nothing: next to each other, two of them may have opposite signs, unless `tried.takes`.
    """
    fitted = _with_own_held(fitted, tracks)
    paths = fitted.paths if fitted.own is None else jax.vmap(moved)(fitted.paths, fitted.own[:, :2])
    parameters, rest = eqx.partition(fitted.dynamics, free_leaves(fitted.dynamics))
    theta, owner, counts, masses = [], [], [], []
    kinds = terms_of(_lagrangian(fitted.dynamics))
    for path, leaf in jax.tree_util.tree_leaves_with_path(parameters):
        name = jax.tree_util.keystr(path)
        kind = _owner(path, kinds)
        theta.append(np.asarray(leaf, float).ravel())
        owner += [kind] * leaf.size
        masses += [".mass." in name] * leaf.size
        counts += [kind is None or name.rsplit(".", 1)[-1] not in kinds[kind].nonlinear] * leaf.size
    flat, owners, linear = np.concatenate(theta), np.array(owner, object), np.array(counts)
    curvature = np.asarray(fitted.curvature, float)
    # Masses follow by about a fifth only: with no mass at all any force could be missing, and where forces act between
    # keypoints alone, such as attraction, this is true of their relative motion for each total mass.
    heavy = np.array(masses)
    step = _FOLLOW * np.sqrt(np.mean(flat[heavy] ** 2))
    curvature = curvature + np.diag(np.where(heavy, 2 * WORTH * float(fitted.cost) / step**2, 0.0))
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-12 * np.diag(curvature).max()))
    curvature, flat = curvature / scale[:, None] / scale[None, :], flat * scale
    _, unravel = ravel_pytree(parameters)

    def dynamics(flat: np.ndarray) -> MechanicalDynamics:
        return eqx.combine(unravel(jnp.asarray(flat / scale, jnp.float32)), rest)

    kept, worth = set(kinds), {}
    dissipations = {kind for kind, term in kinds.items() if isinstance(term, AbstractDissipationTerm)}
    for kind in sorted(kinds, key=lambda kind: kinds[kind].rank, reverse=True):
        group, others = linear & (owners == kind), _others(owners, kept - {kind})
        gives = False
        if kind in dissipations:
            rivals = linear & np.array([owner in (kept & dissipations) - {kind} for owner in owners])
            alone = _without(curvature, flat, rivals, _others(owners, (kept - dissipations) | {kind}))
            laws = [alone, flat] if tried.takes else [alone]
            gives = any(float(_power(_lagrangian(dynamics(law)), kind, paths, tracks.dt)) <= 0 for law in laws)
        worth[kind] = 0.0 if gives else _rise(curvature, flat, group, others) / float(fitted.cost)
        if worth[kind] < tried.worth:
            kept.remove(kind)
            # What the others take over.
            flat = _without(curvature, flat, group, others)
    left = dynamics(flat)
    terms = {kind: term for kind, term in terms_of(_lagrangian(left)).items() if kind in kept}
    return _with_law(left, with_terms(_lagrangian(left), terms)), worth


def _with_own_held(fitted: Fitted, tracks: Tracks) -> Fitted:
    """Return the fit with a curvature for which factors of masses and friction follow by about a fifth only.

    They would take the place of any common factor of V or R.
    """
    if tracks.own is None or fitted.own is None:
        return fitted
    stiff = 2 * WORTH * fitted.cost / (len(fitted.own) * _FOLLOW**2)
    factors = jnp.arange(len(tracks.own.precision)) >= 2
    own = Own(fitted.own, fitted.own, tracks.own.precision + jnp.diag(jnp.where(factors, stiff, 0.0)))
    held = _fitted(fitted.dynamics, dataclasses.replace(tracks, own=own), fitted, iterations=0)
    return fitted._replace(curvature=held.curvature)


def _sound(fitted: Fitted) -> bool:
    """Return whether a fit says anything about the terms: no motion of it diverged."""
    return bool(np.isfinite(fitted.cost) and np.all(np.isfinite(fitted.curvature)))


@eqx.filter_jit
def _power(law: ConstrainedLagrangian, kind: str, paths: jax.Array, dt: jax.Array) -> jax.Array:
    """Return the mean power v·∂R/∂v that a dissipation of this kind takes from motions `[N, T, 2K]`."""
    term = terms_of(law)[kind]
    assert isinstance(term, AbstractDissipationTerm)
    x = paths[:, 1:-1].reshape(-1, paths.shape[-1])
    v = ((paths[:, 2:] - paths[:, :-2]) / (2 * dt)).reshape(-1, paths.shape[-1])
    return jnp.mean(jnp.sum(v * jax.vmap(jax.grad(term, argnums=1))(x, v), axis=1))


def _others(owners: np.ndarray, kinds: set[str]) -> np.ndarray:
    return np.array([owner is None or owner in kinds for owner in owners])


def _rise(curvature: np.ndarray, theta: np.ndarray, group: np.ndarray, others: np.ndarray) -> float:
    """Return by how much the cost rises if a group of parameters becomes zero and the others follow."""
    mixed = curvature[np.ix_(group, others)]
    follow = np.linalg.pinv(curvature[np.ix_(others, others)], rcond=1e-6, hermitian=True)
    schur = curvature[np.ix_(group, group)] - mixed @ follow @ mixed.T
    return max(0.0, 0.5 * float(theta[group] @ schur @ theta[group]))


def _without(curvature: np.ndarray, theta: np.ndarray, group: np.ndarray, others: np.ndarray) -> np.ndarray:
    follow = np.linalg.pinv(curvature[np.ix_(others, others)], rcond=1e-6, hermitian=True)
    theta = theta.copy()
    theta[others] += follow @ curvature[np.ix_(others, group)] @ theta[group]
    theta[group] = 0.0
    return theta
