"""Fits of a law of motion to observed keypoints."""

from collections.abc import Iterable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld.mechanics import (
    ConstrainedLagrangian,
    Fitted,
    MechanicalDynamics,
    fit_motions,
    moved,
    regress_forces,
    rough_states,
    terms_of,
    with_kinds,
    with_terms,
)
from keycld.models.keycld.tracks import SCARCE, Tracks

# The potential energy of free form.
LAST_RESORT = "perceptron"
# About how many recordings all terms together are fitted to.
FEW = 50
# A motion whose error is so many times the median has been lost: it began in a wrong state, or has wrong parameters.
_LOST = 5.0
# Compiled once for each structure of the law.
_fit = eqx.filter_jit(fit_motions)


def fit_law(
    dynamics: MechanicalDynamics,
    tracks: Tracks,
    begin: Fitted | None = None,
    frames: int | None = None,
    iterations: int = 30,
    active: Any = None,
) -> Fitted:
    """Fit dynamics and the motions of recordings together to keypoints.

    Motions with own parameters that an earlier fit has lost say nothing of the law: four of 150 motions of a double
    pendulum, up to 3 pixels off, next to 0.002 of the others, hid that its friction is that of hinges.

    Args:
        dynamics: where the fit begins.
        tracks: keypoints of the recordings.
        begin: an earlier fit whose motions this one begins with; None: with those that the first frames show.
        frames: number of frames, from the first one, that are fitted; None: all.
        iterations: largest number of steps.
        active: 0 for each number of the dynamics that stays, 1 for the others; None: those that `tracks` leave free.
    """
    if active is None:
        active = _active(dynamics, tracks.located)
    own, near = tracks.own, None
    if own is not None and begin is not None and begin.own is not None:
        own, near = own._replace(numbers=begin.own), jnp.asarray(followed(begin))
    absent: list[str] = []
    if own is None and len(tracks.x) < 2 * FEW and LAST_RESORT not in terms_of(lagrangian(dynamics)):
        absent = [kind for kind in tracks.among if kind not in terms_of(lagrangian(dynamics))]
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
        followed=near,
        frames=jnp.array(tracks.x.shape[1] if frames is None else frames),
        iterations=jnp.array(iterations),
    )
    return _without_idle(fitted, absent) if absent else fitted


def climb(dynamics: MechanicalDynamics, tracks: Tracks, active: Any = None) -> Fitted:
    """Fit a quarter, half and the whole of the recordings, each from the result of the last; of a few in eighths.

    A motion that a longer part loses among many does not lead the law away, and one with own parameters that the whole
    loses is left out of a last fit.
    """
    length, fitted = tracks.x.shape[1], None
    for eighths in range(1, 8) if len(tracks.x) <= SCARCE else (2, 4):
        fitted = fit_law(dynamics, tracks, fitted, length * eighths // 8, 8, active)
        dynamics = fitted.dynamics
    fitted = fit_law(dynamics, tracks, fitted, active=active)
    if tracks.own is None or np.array_equal(followed(fitted), fitted.followed):
        return fitted
    return fit_law(fitted.dynamics, tracks, fitted, active=active)


def followed(fitted: Fitted) -> np.ndarray:
    """Return which recordings the fitted motions follow `[N]`; errors of a motion that diverged are no numbers."""
    errors = np.asarray(fitted.errors)
    return errors <= _LOST * np.nanmedian(errors)


def fit_from_nothing(dynamics: MechanicalDynamics, kinds: tuple[str, ...], tracks: Tracks) -> Fitted:
    """Fit an affine V with terms of these kinds, from nothing.

    With own parameters the fit begins from zero forces too: a regression takes all masses for the same.
    """
    law = with_kinds(_affine(lagrangian(dynamics)), kinds, key=jax.random.key(0))
    x = tracks.x if tracks.own is None else jax.vmap(moved)(tracks.x, tracks.own.numbers[:, :2])
    regressed = regress_forces(law, free_leaves(law), x, tracks.u, tracks.dt)
    begins = (regressed,) if tracks.own is None else (regressed, law)
    return cheapest(climb(with_law(dynamics, each), tracks) for each in begins)


def cheapest(fits: Iterable[Fitted]) -> Fitted:
    """Return the fit of least cost; one that diverged has none."""
    return min(fits, key=lambda fitted: float(jnp.nan_to_num(fitted.cost, nan=jnp.inf)))


def sound(fitted: Fitted) -> bool:
    """Return whether a fit says anything about the terms: no motion of it diverged."""
    return bool(np.isfinite(fitted.cost) and np.all(np.isfinite(fitted.curvature)))


def free_leaves(dynamics: Any) -> Any:
    """Return which leaves are fitted: all but the perceptron of g, which has thousands of weights and little to say."""

    def free(path: Any, leaf: Any) -> bool:
        return eqx.is_inexact_array(leaf) and "input_matrix.perceptron" not in jax.tree_util.keystr(path)

    return jax.tree_util.tree_map_with_path(free, dynamics)


def lagrangian(dynamics: MechanicalDynamics) -> ConstrainedLagrangian:
    """Return the law of dynamics whose terms may be exchanged."""
    assert isinstance(dynamics.law, ConstrainedLagrangian)
    return dynamics.law


def with_law(dynamics: MechanicalDynamics, law: ConstrainedLagrangian) -> MechanicalDynamics:
    """Return the dynamics with another law."""
    return eqx.tree_at(lambda d: d.law, dynamics, law)


def owner_of(path: Any, kinds: Iterable[str]) -> str | None:
    """Return the kind of the term that a leaf belongs to."""
    name = jax.tree_util.keystr(path)
    return next((kind for kind in kinds if f"terms['{kind}']" in name), None)


def _active(dynamics: MechanicalDynamics, located: bool) -> Any:
    """Return 1 for each number that a fit changes, 0 for those of the constraints if they are located."""

    def active(path: Any, leaf: Any) -> Any:
        stays = located and ".constraint_function" in jax.tree_util.keystr(path)
        return (jnp.zeros_like if stays else jnp.ones_like)(leaf) if eqx.is_inexact_array(leaf) else leaf

    return jax.tree_util.tree_map_with_path(active, dynamics)


def _with_idle(dynamics: MechanicalDynamics, active: Any, kinds: Sequence[str]) -> tuple[MechanicalDynamics, Any]:
    """Return dynamics with further terms that do not act, and what a fit changes of them: no number of these terms."""
    whole = with_kinds(lagrangian(dynamics), kinds, key=jax.random.key(0))
    idle = {kind: jax.tree.map(jnp.zeros_like, term) for kind, term in terms_of(whole).items() if kind in kinds}
    law = lagrangian(active)
    return with_law(dynamics, whole), with_law(active, with_terms(law, terms_of(law) | idle))


def _without_idle(fitted: Fitted, kinds: Sequence[str]) -> Fitted:
    law = lagrangian(fitted.dynamics)
    left = with_terms(law, {kind: term for kind, term in terms_of(law).items() if kind not in kinds})
    leaves = jax.tree_util.tree_leaves_with_path(eqx.filter(fitted.dynamics, free_leaves(fitted.dynamics)))
    kept = np.concatenate([np.full(leaf.size, owner_of(path, kinds) is None) for path, leaf in leaves])
    return fitted._replace(dynamics=with_law(fitted.dynamics, left), curvature=fitted.curvature[np.ix_(kept, kept)])


def _affine(law: ConstrainedLagrangian) -> ConstrainedLagrangian:
    """Return the law with V = 0, R = 0 and g = 0, all affine."""
    zero = jax.tree.map(lambda leaf: jnp.zeros_like(leaf) if eqx.is_inexact_array(leaf) else leaf, law)
    return with_terms(
        ConstrainedLagrangian(law.mass, zero.potential, zero.input_matrix, law.constraint_function, zero.dissipation),
        {},
    )
