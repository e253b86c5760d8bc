"""Preparations that fit the law of motion to the keypoints observed in the training data.

A preparation is a function (model, resident data) → (model, resident data), called before the first step of a stage.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld._errors import KeycldError
from keycld.data import Resident
from keycld.mechanics import Constraints, DistanceToPoint, Fitted, MechanicalDynamics, is_singular, terms_of
from keycld.models.keycld.exchange import shared_constants
from keycld.models.keycld.identify import identify, refit
from keycld.models.keycld.law_fit import followed
from keycld.models.keycld.model import KeyCLD
from keycld.models.keycld.observe import FITTED, chosen, observe, observed_keypoints
from keycld.models.keycld.own_initial_state import own_guess
from keycld.models.keycld.selection import Tried
from keycld.models.keycld.tracks import Tracks
from keycld.vision import pixel_size

# Radians that positions must span around a pivot to determine it alone.
_TURNED = 1.5


def cache_keypoints(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Cache the keypoints that the model observes in every training frame, `[N, T, 2K]`."""
    observed = jnp.stack([observe(model, data.image[i]) for i in range(len(data.u))])
    return model, eqx.tree_at(lambda d: d.cached, data, observed, is_leaf=lambda x: x is None)


def share_constants(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Put the mean of Φ over all cached keypoints into the model, if its trajectories share constants."""
    assert data.cached is not None
    return _sharing(model, data.cached), data


def identify_dynamics(
    model: Any, data: Resident, *, terms: tuple[str, ...] | None = None, tried: Tried | None = None
) -> tuple[Any, Resident]:
    """Find the forces that act from the keypoints of some recordings: `identify`, and print what it found.

    Unknown pivots and directions of the constraints, and the constants of Φ, are measured on the same keypoints first.
    A model without a Lagrangian is returned unchanged.

    Args:
        model: the model whose dynamics are identified.
        data: the training data.
        terms: kinds of the terms of V and R; None: those that the motion asks for.
        tried: which kinds are tried, and what they must be worth; None: all.

    Raises:
        KeycldError: the constraints are singular at most observed keypoints (`is_singular`).
    """
    if not isinstance(model, KeyCLD):
        return model, data
    model = _told_apart(model, data)
    x, u = observed_keypoints(model, data, FITTED)
    model, pixel = _sharing(model.located(x.reshape(-1, x.shape[-1])), x), pixel_size(*data.shape[2:4])
    assert isinstance(model.dynamics, MechanicalDynamics)
    if is_singular(model.law.constraint_function, x.reshape(-1, x.shape[-1])[:: max(1, x.shape[1] // 2)]):
        raise KeycldError(
            "the constraints are singular where the keypoints are: three of them in one line, or two in line with "
            "their pivot, are not held by distances alone. Take one keypoint less, or a relation that says more "
            "(docs/constraints.md)."
        )
    tracks = _tracks(model, x, u, data.dt, tried)
    found = identify(model.dynamics, tracks, pixel=pixel, terms=terms, tried=tried)
    model = _sharing(eqx.tree_at(lambda m: m.dynamics, model, found.dynamics), x)
    _report(model, found.rms / pixel)
    return model, data


def fit_dynamics(
    model: Any, data: Resident, *, trajectories: int = FITTED, tried: Tried | None = None, anew: bool = False
) -> tuple[Any, Resident]:
    """Fit masses, V, g and R to the keypoints of some recordings, by least squares through the dynamics.

    Gradient steps on a few clips leave errors of several per cent in these numbers, about fifty, and such errors limit
    long predictions. Whole trajectories determine them. The constants of Φ are measured on the same keypoints first. A
    model without a Lagrangian is returned unchanged.

    Args:
        model: the model whose dynamics are fitted.
        data: the training data.
        trajectories: about how many of the recordings are observed.
        tried: drop terms of V and R that the motion does not ask for after all; None: keep all.
        anew: identify the forces anew; they take the place of the model's unless they explain less (`refit`).
    """
    if not isinstance(model, KeyCLD):
        return model, data
    x, u = observed_keypoints(model, data, trajectories)
    model = _sharing(model, x)
    assert isinstance(model.dynamics, MechanicalDynamics)
    tracks = _tracks(model, x, u, data.dt, tried)
    fitted, tracks = refit(model.dynamics, tracks, tried=tried, anew=anew)
    model = _sharing(eqx.tree_at(lambda m: m.dynamics, model, fitted.dynamics), x)
    if tried is not None:
        _report(model, float(fitted.rms) / pixel_size(*data.shape[2:4]))
    # The median of |e| of a normal distribution is 0.67 σ.
    error = jnp.median(jnp.abs(fitted.paths - tracks.x).reshape(-1, x.shape[-1] // 2, 2), axis=(0, 2)) / 0.67
    model = eqx.tree_at(lambda m: m.initial_state.error, model, jnp.maximum(error, 1e-5))
    return model, data if fitted.own is None else _with_paths(data, fitted, trajectories)


def fit_again(model: Any, data: Resident, *, tried: Tried | None = None) -> tuple[Any, Resident]:
    """Fit as `fit_dynamics` after unknown pivots and directions were located once more, on all keypoints.

    Forces are identified anew. On five seconds of a swinging ball, dry friction explained a viscous one better by 13 %,
    and half a second more told them apart.
    """
    if isinstance(model, KeyCLD):
        x, _ = observed_keypoints(model, data, FITTED)
        model = model.located(x.reshape(-1, x.shape[-1]))
    return fit_dynamics(model, data, tried=tried, anew=True)


def _told_apart(model: KeyCLD, data: Resident) -> KeyCLD:
    """Return the model with the constants that tell its parts apart, where these exchange their looks."""
    if not model.exchange or model.initial_state.shared is None:
        return model
    some, begin, span = chosen(data, FITTED)
    x = [_unnamed(model, data.image[i][k : k + span]) for i, k in zip(some, begin, strict=True)]
    constants = shared_constants(model.constraint, np.stack(x))
    return eqx.tree_at(lambda m: m.initial_state.constants, model, constants)


def _report(model: KeyCLD, pixels: float) -> None:
    acting = "".join(f", {kind}" for kind in terms_of(model.law))
    for name, value in model.law.constraint_function.unknowns.items():
        acting += f"; {name} {np.array2string(np.asarray(value), precision=3, separator=', ')}"
    print(f"dynamics     affine V{acting}; fitted paths are {pixels:.2f} pixels from the keypoints", flush=True)


def _tracks(model: Any, x: jax.Array, u: jax.Array, dt: jax.Array, tried: Tried | None) -> Tracks:
    return Tracks(x, u, dt, model.constants, _located(model, x, tried), own_guess(model, x))


def _with_paths(data: Resident, fitted: Fitted, trajectories: int) -> Resident:
    """Return the data with the fitted paths cached, where there are any."""
    rows, begin, span = chosen(data, trajectories)
    paths, near = np.asarray(fitted.paths), followed(fitted)
    cached = np.full((*data.image.shape[:2], paths.shape[-1]), np.nan, np.float32)
    for k, (i, first) in enumerate(zip(rows, begin, strict=True)):
        if near[k]:
            cached[i, first : first + span] = paths[k]
    return eqx.tree_at(lambda d: d.cached, data, jnp.asarray(cached), is_leaf=lambda x: x is None)


def _located(model: KeyCLD, x: jax.Array, tried: Tried | None) -> bool:
    """Return whether unknown numbers of the constraints stay where the positions `[N, T, 2K]` put them (`Tried`)."""
    phi = model.law.constraint_function
    if tried is None or not tried.located or not isinstance(phi, Constraints):
        return False
    points = np.asarray(x, float).reshape(-1, len(phi.keypoints), 2)
    for item in phi.items:
        if isinstance(item, DistanceToPoint) and item.learned is not None:
            away = points[:, phi.keypoints.index(item.keypoint)] - np.asarray(item.learned)
            middle = np.arctan2(*away.mean(axis=0)[::-1])
            turned = np.angle(np.exp(1j * (np.arctan2(away[:, 1], away[:, 0]) - middle)))
            if np.ptp(turned) < _TURNED:
                return False
    return True


def _sharing(model: Any, x: jax.Array) -> Any:
    if model.initial_state.shared is None:
        return model
    values = jax.vmap(model.constraint)(x.reshape(-1, x.shape[-1]))
    return eqx.tree_at(lambda m: m.initial_state.constants, model, jnp.mean(values, axis=0))


@eqx.filter_jit
def _unnamed(model: Any, image: jax.Array) -> jax.Array:
    """Return the keypoints of a recording as the estimator numbers them."""
    return jax.vmap(lambda frame: model.estimator(frame).keypoints)(image.astype(jnp.float32) / 255.0)
