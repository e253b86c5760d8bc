"""Preparations before the first step of a stage.

A preparation is a function (model, resident data) → (model, resident data).
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld._errors import KeycldError
from keycld.data import Resident
from keycld.mechanics import (
    Constraints,
    DistanceToPoint,
    Fitted,
    MechanicalDynamics,
    Motion,
    Own,
    State,
    is_singular,
    moved,
    rough_places,
    terms_of,
)
from keycld.models.keycld.config import MOST_ORDERED
from keycld.models.keycld.exchange import orders, shared_constants
from keycld.models.keycld.identify import identify, refit
from keycld.models.keycld.law_fit import followed
from keycld.models.keycld.losses import unevenness
from keycld.models.keycld.model import KeyCLD
from keycld.models.keycld.own_initial_state import OwnInitialState, OwnPrior
from keycld.models.keycld.part_light import PartLight, most_frequent
from keycld.models.keycld.selection import Tried
from keycld.models.keycld.tracks import Tracks
from keycld.models.keycld.velocity_prior import VelocityPrior
from keycld.vision import fit_discs, pixel_size, still_background

# Mean frame and deviation are measured on at least so many trajectories, if there are as many.
_MEASURED = 200
# Radians that positions must span around a pivot to determine it alone.
_TURNED = 1.5
# About how many recordings a fit observes, and a comparison.
FITTED, COMPARED = 150, 8
# Consecutive frames of a recording that a fit observes, at most. They tell the forces; more frames cost memory and time
# in proportion, and tell little where nearby motions part. Of few recordings all frames are observed.
_SPAN, _MOST = 80, 12_000
# Deviations of places and of the logarithms of factors in a wide prior, and of an observation next to which it is wide.
_WIDE, _EXACT = (0.3, 0.5), 1e-3
# Frames that are given, as the prior of own parameters sees them.
_SEEN = 5
# Share of the light that discs may leave. Of soft discs in 256 values it is 1 %.
_UNEXPLAINED = 0.03
# About how many recordings show whether parts are discs.
_LOOKED = 24


def measure_statistics(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Put the mean frame and the deviation of the training data into the estimator and the renderer.

    Raises:
        KeycldError: all training frames are the same.
    """
    mean, deviation = _mean_and_deviation(data)
    if not deviation > 0:
        raise KeycldError("all training frames are the same, so there is no motion to learn from: check the data.")
    return _in_front_of(model, mean, deviation), data


def measure_background(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Put what is behind the parts in place of the mean frame, and the deviation from it.

    Of a clip with one motion the mean frame shows the parts where they turn round, faintly.

    Raises:
        KeycldError: all training frames are the same.
    """
    model, data = measure_statistics(model, data)
    frames = np.asarray(data.image).reshape(-1, *data.image.shape[2:])
    found = still_background(frames)
    deviation = np.sqrt(np.mean([np.mean((frame / 255.0 - found) ** 2) for frame in frames]))
    return _in_front_of(model, jnp.asarray(found, jnp.float32), jnp.asarray(deviation, jnp.float32)), data


def _in_front_of(model: Any, background: jax.Array, deviation: jax.Array) -> Any:
    """Return the model that sees the deviations from a background, and renders the parts in front of it."""
    return eqx.tree_at(
        lambda m: (m.estimator.standardise.mean, m.estimator.standardise.deviation, m.renderer.background),
        model,
        (background, deviation, background),
    )


def name_keypoints(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Exchange the names of keypoints where the constraints then hold much better.

    Keypoints that have found their parts under each other's names cannot change places by gradients: they would have to
    leave their parts. The names are exchanged if this halves the unevenness of the constraints, which symmetric
    mechanisms never reach. Models with one keypoint, or more than six, are returned unchanged, and those whose parts
    exchange their looks.

    Args:
        model: during the vision stage.
        data: the training data.
    """
    if model.exchange:
        return model, data
    x, _ = observed_keypoints(model, data, COMPARED)
    count = x.shape[-1] // 2
    if not 1 < count <= MOST_ORDERED:
        return model, data
    choices = orders(count)
    uneven = _uneven_in_orders(model, x.reshape(-1, count, 2), choices)
    best = jnp.argmin(uneven)
    if not uneven[best] < 0.5 * uneven[0]:
        return model, data
    parts = model.estimator.reordered(choices[best]), model.renderer.reordered(choices[best])
    return eqx.tree_at(lambda m: (m.estimator, m.renderer), model, parts), data


def cache_keypoints(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Cache the keypoints that the model observes in every training frame, `[N, T, 2K]`."""
    observed = jnp.stack([_observe(model, data.image[i]) for i in range(len(data.u))])
    return model, eqx.tree_at(lambda d: d.cached, data, observed, is_leaf=lambda x: x is None)


def share_constants(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Put the mean of Φ over all cached keypoints into the model, if its trajectories share constants."""
    assert data.cached is not None
    return _sharing(model, data.cached), data


def measure_part_light(model: Any, data: Resident, *, discs: bool = True) -> tuple[Any, Resident]:
    """Measure the background of the light of the parts (`PartLight`), and whether these are soft discs.

    They are if discs leave less than 3 % of the light, and are within a pixel of the keypoints, in the median. A model
    without own parameters looks at the light of discs alone.

    Args:
        model: the model whose parts are looked at.
        data: the training data.
        discs: whether the parts may be discs.
    """
    some, begin, _ = _chosen(data, FITTED)
    frames = np.stack([np.asarray(data.image[i][k]) for i, k in zip(some, begin, strict=True)])
    background = jnp.asarray(most_frequent(frames), jnp.float32)
    few = list(zip(some, begin, strict=True))[:: max(1, len(some) // _LOOKED)]
    looked = [_discs(model, data.image[i][k : k + _SEEN], background) for i, k in few]
    away, left = (float(np.median(np.abs(each))) for each in zip(*looked, strict=True))
    away = away / pixel_size(*data.shape[2:4])
    taken = discs and away < 1 and left < _UNEXPLAINED
    print(
        f"light        discs are {away:.2f} pixels from the keypoints and leave {100 * left:.1f} % of the light: "
        f"{'taken' if taken else 'not taken'}",
        flush=True,
    )
    if not taken and model.part_light is None:
        return model, data
    light = PartLight(background, jnp.asarray(float(taken)))
    return eqx.tree_at(lambda m: m.part_light, model, light, is_leaf=lambda x: x is None), data


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


def measure_velocity_prior(model: Any, data: Resident, *, trajectories: int = FITTED) -> tuple[Any, Resident]:
    """Measure the velocity prior (`VelocityPrior`) on the observed keypoints of training recordings.

    τ is the time after rest whose velocities τ a predict the recordings best. σ_s² / (σ_s² + σ_b²) is the best step
    from the observed velocities v_s towards τ a, as a share of their difference d. σ_s² + σ_b² is the median of |d|²
    for each degree of freedom, so that a minority of recordings may have any initial velocity. A model without a prior
    is returned unchanged.

    Args:
        model: the model whose prior is measured.
        data: the training data.
        trajectories: about how many of the recordings are observed.
    """
    if model.velocity_prior is None:
        return model, data
    x, u = observed_keypoints(model, data, trajectories, taken_up=False)
    return eqx.tree_at(lambda m: m.velocity_prior, model, _velocity_prior(model, x, u, data.dt)), data


def measure_own_prior(model: Any, data: Resident) -> tuple[Any, Resident]:
    """Fit once more, and measure the prior of own parameters (`OwnPrior`) on recordings whose motion tells them.

    Recordings that no motion of the law follows are left out.
    """
    rows, begin, _ = _chosen(data, FITTED)
    x, u = observed_keypoints(model, data, FITTED)
    fitted, _ = refit(model.dynamics, _tracks(model, x, u, data.dt, None))
    own, x = np.asarray(fitted.own, float), np.asarray(x)
    near = followed(fitted)
    light = [_light(model, data.image[i][k : k + _SEEN]) for i, k in zip(rows, begin, strict=True)]
    constants = jax.vmap(lambda x, place: jnp.mean(jax.vmap(model.constraint)(moved(x, place)), axis=0))(
        jnp.asarray(x), jnp.asarray(own[:, :2], jnp.float32)
    )
    prior = OwnPrior.measured(own[near], x[near, :_SEEN], np.stack(light)[near], np.asarray(constants)[near])
    spread = np.sqrt(np.diagonal(prior.factor_root @ prior.factor_root.T))
    print(
        f"own          {near.sum()} recordings; log factors of masses and friction vary by "
        f"{np.array2string(own[near][:, 2:].std(axis=0), precision=3)}, known to "
        f"{np.array2string(spread, precision=3)} by what is seen",
        flush=True,
    )
    # Factors mean nothing without the law of the same fit: (μ, V) is known up to a common factor.
    return eqx.tree_at(lambda m: (m.dynamics, m.initial_state.prior), model, (fitted.dynamics, prior)), data


def _told_apart(model: KeyCLD, data: Resident) -> KeyCLD:
    """Return the model with the constants that tell its parts apart, where these exchange their looks."""
    if not model.exchange or model.initial_state.shared is None:
        return model
    some, begin, span = _chosen(data, FITTED)
    x = [_unnamed(model, data.image[i][k : k + span]) for i, k in zip(some, begin, strict=True)]
    constants = shared_constants(model.constraint, np.stack(x))
    return eqx.tree_at(lambda m: m.initial_state.constants, model, constants)


def _report(model: KeyCLD, pixels: float) -> None:
    acting = "".join(f", {kind}" for kind in terms_of(model.law))
    for name, value in model.law.constraint_function.unknowns.items():
        acting += f"; {name} {np.array2string(np.asarray(value), precision=3, separator=', ')}"
    print(f"dynamics     affine V{acting}; fitted paths are {pixels:.2f} pixels from the keypoints", flush=True)


def observed_keypoints(
    model: Any, data: Resident, trajectories: int, first: int = 0, *, taken_up: bool = True
) -> tuple[jax.Array, jax.Array]:
    """Return the keypoints `[n, T, 2K]` that the model observes in about so many recordings, and their inputs.

    Many long recordings are observed for a while only: `taken_up`, from frames on that are spread over them, else from
    their first frame on.
    """
    some, begin, span = _chosen(data, trajectories, first, taken_up=taken_up)
    x = [_observe(model, data.image[i][k : k + span]) for i, k in zip(some, begin, strict=True)]
    u = data.u[some.start : some.stop : some.step]
    if u.ndim == 3:
        u = jnp.stack([each[k : k + span] for each, k in zip(u, begin, strict=True)])
    return jnp.stack(x), u


def _chosen(
    data: Resident, trajectories: int, first: int = 0, *, taken_up: bool = True
) -> tuple[range, np.ndarray, int]:
    """Return the recordings that `observed_keypoints` observes, the first frame in each, and how many frames."""
    step = max(1, len(data.u) // trajectories)
    some, length = range(first % step, len(data.u), step), data.image.shape[1]
    span = min(length, max(_SPAN, _MOST // len(some)))
    return some, np.linspace(0, (length - span) * taken_up, len(some)).round().astype(int), span


def own_guess(model: Any, x: jax.Array) -> Own | None:
    """Return a first guess and a wide prior of the own parameters in keypoints `[N, T, 2K]`; None without any."""
    if not isinstance(model.initial_state, OwnInitialState):
        return None
    numbers = jnp.concatenate(
        [rough_places(model.law, x), jnp.zeros((len(x), len(model.initial_state.prior.factors)))], axis=1
    )
    spread = jnp.where(jnp.arange(numbers.shape[1]) < 2, *_WIDE)
    return Own(numbers, numbers, jnp.diag((_EXACT / spread) ** 2))


def _tracks(model: Any, x: jax.Array, u: jax.Array, dt: jax.Array, tried: Tried | None) -> Tracks:
    return Tracks(x, u, dt, model.constants, _located(model, x, tried), own_guess(model, x))


def _with_paths(data: Resident, fitted: Fitted, trajectories: int) -> Resident:
    """Return the data with the fitted paths cached, where there are any."""
    rows, begin, span = _chosen(data, trajectories)
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
def _uneven_in_orders(model: Any, x: jax.Array, orders: jax.Array) -> jax.Array:
    """Return the sum of U_i for keypoints `[B, K, 2]` in each order `[P, K]`."""

    def uneven(order: jax.Array) -> jax.Array:
        ordered = x[:, order].reshape(len(x), -1)
        return jnp.sum(unevenness(model.located(ordered), ordered)[0])

    return jax.lax.map(uneven, orders)


# Compiled once for all stages.
@eqx.filter_jit
def _observe(model: Any, image: jax.Array) -> jax.Array:
    frames = image.astype(jnp.float32) / 255.0
    return model.observe_clips(frames[None]).keypoints.reshape(len(frames), -1)


@eqx.filter_jit
def _unnamed(model: Any, image: jax.Array) -> jax.Array:
    """Return the keypoints of a recording as the estimator numbers them."""
    return jax.vmap(lambda frame: model.estimator(frame).keypoints)(image.astype(jnp.float32) / 255.0)


@eqx.filter_jit
def _light(model: Any, image: jax.Array) -> jax.Array:
    frames = image.astype(jnp.float32) / 255.0
    return model.part_light(frames, model.observe_clips(frames[None]).keypoints).reshape(-1)


@eqx.filter_jit
def _discs(model: Any, image: jax.Array, background: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return how far discs are from the keypoints, and the light that they leave."""
    frames = image.astype(jnp.float32) / 255.0
    x = model.observe_clips(frames[None]).keypoints
    found = fit_discs(frames, background, x)
    return found.centres - x, found.left


@eqx.filter_jit
def _velocity_prior(
    model: Any, keypoints: jax.Array, u: jax.Array, dt: jax.Array, *, scale: float = 0.03
) -> VelocityPrior:
    dynamics, law = model.dynamics, model.dynamics.law
    freedom = law.freedom
    initial = jax.vmap(lambda x, u: model.initial_state(dynamics, x[: model.context], dt, u))(keypoints, u)
    x, observed = initial.coordinates
    # The input of the last frame acts after it.
    first, acting = (u, u) if u.ndim == 2 else (u[:, 0], u[:, : keypoints.shape[1] - 1])
    acceleration = jax.vmap(lambda x, u: law.acceleration(x, jnp.zeros_like(x), u))(x, first)

    def error(v: jax.Array) -> jax.Array:
        """Return the robust error of predictions with these initial velocities; diverged ones count little."""
        states = State(Motion(x, v), initial.parameters)
        paths = jax.vmap(lambda state, u: dynamics.rollout(state, u, dt, keypoints.shape[1] - 1).x)(states, acting)
        far = jnp.nan_to_num(jnp.sum((paths - keypoints) ** 2, axis=-1), nan=1.0, posinf=1.0)
        return jnp.mean(jnp.sqrt(1 + far / scale**2))

    def best(choices: jax.Array, velocities: Any) -> jax.Array:
        return choices[jnp.argmin(jax.lax.map(lambda choice: error(velocities(choice)), choices))]

    elapsed = best(dt * jnp.linspace(0.0, 3.0, 31), lambda elapsed: elapsed * acceleration)
    off = observed - elapsed * acceleration
    part = best(jnp.linspace(0.0, 1.0, 21), lambda part: observed - part * off)
    # The median of χ² with n degrees of freedom is near n (1 − 2/9n)³.
    variance = jnp.nanmedian(jnp.sum(off**2, axis=-1)) / (freedom * (1 - 2 / (9 * freedom)) ** 3) + 1e-12
    speed = jnp.sqrt(jnp.mean(jnp.sum(jnp.diff(keypoints, axis=1) ** 2, axis=-1)) / freedom) / dt
    return VelocityPrior(elapsed, jnp.sqrt((1 - part) * variance), jnp.sqrt(part * variance), speed)


def _mean_and_deviation(data: Resident) -> tuple[jax.Array, jax.Array]:
    # One trajectory at a time, in NumPy: uint8 sums stay exact, and no float copy of the data is made.
    count = data.image.shape[0]
    some = range(0, count, max(1, count // _MEASURED))
    mean = np.zeros(data.image.shape[2:])
    for i in some:
        mean += np.asarray(data.image[i]).mean(0) / len(some)
    mean /= 255.0
    variance = np.mean([np.mean((np.asarray(data.image[i]) / 255.0 - mean) ** 2) for i in some])
    return jnp.asarray(mean, jnp.float32), jnp.asarray(np.sqrt(variance), jnp.float32)
