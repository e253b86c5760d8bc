"""Judgements after the last step of a stage: whether it has found what the next stage builds on."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from keycld.data import Resident
from keycld.mechanics import ConstrainedLagrangian, MechanicalDynamics, moved, turns_within, variation
from keycld.models.keycld.identify import explain
from keycld.models.keycld.losses import squared_error
from keycld.models.keycld.model import KeyCLD
from keycld.models.keycld.observe import COMPARED, FITTED, observed_keypoints, spread
from keycld.models.keycld.own_initial_state import OwnInitialState, own_guess
from keycld.models.keycld.selection import Tried
from keycld.models.keycld.tracks import MISSED, Tracks, nearest_polynomials
from keycld.vision import image_grid, pixel_size

# How many of their own errors a law may be away from the keypoints, and how many where it misses much of the motion.
_ERRORS, _NEAR = 5.0, 2.0
# Share of itself by which a distance that is constant may vary after the stage vision, and at the end.
_LOOSE, _TIGHT = 0.1, 0.05
# Pixels by which a part moves, root mean square, and share of what the fastest keypoint does.
_MOVES, _MOVES_OF = 0.5, 0.1
# Share of the recordings that a fit may lose: the worst of them do not count.
_LOST = 0.05
# Recordings that are observed this many times as long, and as few.
_LONGER = 3
# Frames of a recording in which constraints are compared.
_SEEN = 80
# Share of the largest brightness of what moves that is seen at some keypoint, and the width over which it is averaged,
# image-plane units.
_STANDS_OUT, _WIDE = 0.7, 0.06
# Frames of the cubics that show how keypoints scatter: an odd number.
_WINDOW = 7


def judge_vision(model: Any, data: Resident, *, worst: float) -> str | None:
    """Return what has failed in the vision stage, or None: moving parts may be missing from the rendered frames.

    It prints the criterion.

    The criterion is the reconstruction error of some recordings, as a share of the error of the mean frame. Measured:
    0.01 to 0.08 after successful stages, 0.27 to 1.0 after failed ones, which later stages seldom correct.

    Args:
        model: after the stage.
        data: the training data.
        worst: the largest share that passes.
    """
    some = spread(data, COMPARED)
    error = float(np.mean([_rendering_error(model, data.image[i]) for i in some]))
    whole = float(model.estimator.standardise.deviation) ** 2 * model.renderer.background.size
    share = error / whole
    # Pictures with many moving pixels have large errors, so the number in the log says little by itself.
    print(f"pictures     the reconstruction error is {share:.2f} of the mean picture's error", flush=True)
    if share < worst:
        return None
    return (
        f"the keypoints have not found their parts: the reconstruction error is {share:.2f} of the mean picture's "
        f"error, more than {worst:g}. Try --vision.steps 2000 (keycld watch: --set vision.steps=2000), or check that "
        "there is a keypoint for each moving part."
    )


def judge_clip(model: Any, data: Resident, *, worst: float) -> str | None:
    """Return what has failed in the vision stage of a clip, or None: as `judge_vision`, or no keypoint is on its part.

    From a place half-way along a thin string the network can render the ball at its end too, and the law of that place
    is a right one around another pivot. So some keypoint must be where the frames differ from the background: by 0.7 of
    the most, a mean over 0.06 units. Measured: 0.11 on such a string, where period, pivot and gravity were wrong by 1.5
    %, 0.4 units and 13°, and 0.56 on a spring; 0.85 to 1.01 in 33 trainings on drawn and real clips whose keypoints are
    on their parts.

    Args:
        model: after the stage; its estimator knows the background.
        data: the training data.
        worst: as in `judge_vision`.
    """
    failure = judge_vision(model, data, worst=worst)
    if failure is not None:
        return failure
    share = _stands_out(model, data)
    if share >= _STANDS_OUT:
        return None
    return (
        "no keypoint is on the part that stands out most: it differs from the background, and the place of the nearest "
        f"keypoint by {share:.0%} of that. Try another --seed, --crop closer around the motion, or larger pictures "
        "(--size)."
    )


def judge_dynamics(
    model: Any,
    data: Resident,
    *,
    worst: float,
    small: float = 0.0,
    loose: float = _LOOSE,
    tried: Tried | None = None,
) -> str | None:
    """Return what has failed in the dynamics stage, or None: the law may not explain how the keypoints move.

    The motions of the law that come nearest to the observed keypoints of some recordings are compared, for each
    keypoint, with what the keypoints themselves are wrong by (`observation_error`): a right law is as far from them.
    These are mostly other recordings than those it was identified on where there are 300 or more. Keypoints may also
    have errors that it does not know. So errors pass, too, that are small next to those of constant acceleration,
    fitted alike, which show how much there is to explain. A twentieth of the recordings may be lost by a fit, for
    example where bodies nearly collide, and does not count. Errors of more than a fifth of the motion pass only within
    twice those of keypoints, which are large where these leave their parts.

    A keypoint within a pixel of a point from which the constraints keep it at a distance has found this point in place
    of its part. The law then explains its motion and is wrong, so it fails at once. So does one that moves by less than
    half a pixel and a tenth of what another moves by, such as on a clock in the picture, and a constraint that does not
    hold: keypoints that slide on their parts, or follow others, may still obey some law.

    Measured, the share of a distance by which it varies (`variation`): 0.3 to 1.2 % for keypoints on their parts, 2.9 %
    for a real double pendulum whose tip is covered at times; 4 and 5 % for a four-bar linkage with two names exchanged,
    11 % for an animated double pendulum with one keypoint near the pivot, whose law was 0.5 pixels away and passed.

    Slow motions show too little of the law in a short time. A law that does not pass on many recordings is judged on
    fewer and longer stretches too. Two bodies of unknown masses, in units of constant acceleration over 80 and 240
    frames: 0.2 and 0.1 with attraction, 0.6 and 0.8 with springs in its place.

    Right laws are 0.8 to 1.8 of the keypoints' own errors away, on clips of real pendulums up to 4.4, and wrong ones
    mostly 5 and more (`results/zoo.json`, `judgement`). Some wrong laws pass where keypoints show no more.

    Args:
        model: after the stage; None is returned for one without a Lagrangian.
        data: the training data.
        worst: the largest share of the errors of constant acceleration that passes. 1 or more: everything does.
        small: pixels of error that pass. After vision alone keypoints may be wrong by tenths of a pixel, in ways that
            last for many frames; where motions are slow, a right law is then no nearer than constant accelerations.
            The stage joint corrects them (two bodies: 0.21 → 0.01 pixels), and less passes after it.
        loose: the largest share of itself by which a constant distance may vary, unless recordings have own parameters.
        tried: which forces the law was chosen from: a fit to a few recordings is compiled for all of them already.
    """
    if worst >= 1 or not isinstance(model, KeyCLD) or not isinstance(model.dynamics, MechanicalDynamics):
        return None
    failure, frames = None, 0
    for count in (FITTED, FITTED // _LONGER):
        x, u = observed_keypoints(model, data, count, first=1)
        if x.shape[1] == frames:
            break
        pixel = pixel_size(*data.shape[2:4])
        if not frames and (failure := _collapsed(model.law, x, pixel) or _still(x, pixel) or _sliding(model, x, loose)):
            break
        failure, frames = _unexplained(model, data, x, u, worst, small, tried), x.shape[1]
        if failure is None:
            break
    return failure


def _collapsed(law: ConstrainedLagrangian, x: jax.Array, pixel: float) -> str | None:
    """Return which observed keypoints `[N, T, 2K]` are within a pixel of what they keep a distance from, or None."""
    some = x.reshape(-1, x.shape[-1])[:: max(1, x.shape[1] // 2)]
    turning = turns_within(law.constraint_function, some, pixel)
    if not turning:
        return None
    acts = np.asarray(jax.vmap(law.jacobian)(some))[:, turning[0]].reshape(len(some), -1, 2)
    on = np.flatnonzero(np.any(acts, axis=(0, 2))) + 1
    near = f"keypoint {on[0]} is" if len(on) == 1 else f"keypoints {', '.join(map(str, on))} are"
    return (
        f"{near} within a pixel of what constraint {turning[0] + 1} keeps a distance from: a pivot or another part "
        "was found in place of the part that moves. Try another --seed, larger pictures, or a keypoint elsewhere."
    )


def _still(x: jax.Array, pixel: float) -> str | None:
    """Return which of the observed keypoints `[N, T, 2K]` hardly moves while others do, or None."""
    places = np.asarray(x, float).reshape(-1, x.shape[-1] // 2, 2)
    moves = np.sqrt(np.sum(np.var(places, axis=0), axis=-1)) / pixel
    k = int(np.argmin(moves))
    if moves[k] > min(_MOVES, _MOVES_OF * moves.max()):
        return None
    return (
        f"keypoint {k + 1} moves by {moves[k]:.2f} pixels and another by {moves.max():.0f}: it has found something "
        "other than its part, such as a clock in the picture. Leave that out (--crop), or try another --seed."
    )


def _sliding(model: KeyCLD, x: jax.Array, loose: float) -> str | None:
    """Return which constraint observed keypoints `[N, T, 2K]` do not obey, or None."""
    if isinstance(model.initial_state, OwnInitialState):
        return None
    shares = variation(model.law.constraint_function, x[:, :: max(1, x.shape[1] // _SEEN)])
    if not len(shares) or shares.max() < loose:
        return None
    return (
        f"constraint {np.argmax(shares) + 1} does not hold: a distance that it keeps constant varies by "
        f"{shares.max():.0%} of itself, and {loose:.0%} pass. Keypoints slide on their parts, or follow others. Try "
        "another --seed, larger pictures, or keypoints elsewhere."
    )


def _unexplained(
    model: KeyCLD, data: Resident, x: jax.Array, u: jax.Array, worst: float, small: float, tried: Tried | None
) -> str | None:
    """Return what the law of a model does not explain of observed keypoints `[N, T, 2K]`, or None."""
    assert isinstance(model.dynamics, MechanicalDynamics)
    pixel = pixel_size(*data.shape[2:4])
    among = () if tried is None else tried.named
    recordings = Tracks(x, u, data.dt, model.constants, own=own_guess(model, x), among=among)
    fitted, tracks = explain(model.dynamics, recordings)
    x = tracks.x
    seen = np.asarray(x, float).reshape(*x.shape[:2], -1, 2)

    def squares(paths: np.ndarray) -> np.ndarray:
        return np.mean((paths.reshape(seen.shape) - seen) ** 2, axis=(1, 3))

    law = squares(np.asarray(fitted.paths))
    followed = np.argsort(np.sum(law, axis=1))[: len(x) - int(_LOST * len(x))]

    def errors(squares: np.ndarray) -> np.ndarray:
        return np.sqrt(np.mean(squares[followed], axis=0)) / pixel

    straight, curved = (errors(squares(np.asarray(nearest_polynomials(x, degree)))) for degree in (1, 2))
    law = errors(law)
    around = x if fitted.own is None else jax.vmap(moved)(x, fitted.own[:, :2])
    own = observation_error(model.law, np.asarray(around, float)) / pixel
    extent = errors(squares(np.asarray(nearest_polynomials(x, 0))))
    most = np.minimum(np.maximum(worst * curved, _ERRORS * own), MISSED * extent)
    most = np.maximum(np.maximum(most, _NEAR * own), small)
    k = int(np.argmax(law / most))
    print(
        f"law          {law[k]:.2f} pixels from keypoint {k + 1} over {x.shape[1]} frames; up to {most[k]:.2f} passes",
        flush=True,
    )
    if law[k] < most[k]:
        return None
    return (
        f"no law was found that explains how keypoint {k + 1} moves: fitted motions are {law[k]:.2f} pixels from it, "
        f"those of constant velocity {straight[k]:.2f}, of constant acceleration {curved[k]:.2f}; its own errors are "
        f"{own[k]:.2f}. Check keypoints and constraints, and that all inputs are in the data."
    )


def observation_error(law: ConstrainedLagrangian, x: Float[np.ndarray, "N T dim"]) -> Float[np.ndarray, "K"]:
    """Return an estimate from below of the standard deviation of each observed keypoint's errors.

    It is the larger of two: of the scatter around cubics through seven frames, and of the distance from positions that
    obey the constraints. The second one knows errors that last, in directions in which the constraints hold a keypoint.

    Args:
        law: its constraints; their constants are those of each recording's mean.
        x: observed keypoints, image-plane units.
    """
    count = x.shape[-1] // 2

    def deviation(error: np.ndarray, free: Any) -> np.ndarray:
        return np.sqrt(np.sum(error.reshape(-1, count, 2) ** 2, axis=(0, 2)) / np.maximum(free, 1e-9))

    rest = np.zeros(count)
    if x.shape[1] >= _WINDOW:
        powers = np.vander(np.linspace(-1, 1, _WINDOW), 4)
        middle = np.eye(_WINDOW)[_WINDOW // 2] - (powers @ np.linalg.pinv(powers))[_WINDOW // 2]
        scatter = np.lib.stride_tricks.sliding_window_view(x, _WINDOW, axis=1) @ middle
        rest = deviation(scatter, scatter.size / count * np.sum(middle**2))
    flat = jnp.asarray(x.reshape(-1, x.shape[-1]), jnp.float32)
    phi = np.asarray(jax.vmap(law.constraint)(flat), float).reshape(*x.shape[:2], -1)
    if not phi.shape[-1]:
        return rest
    jacobian = np.asarray(jax.vmap(law.jacobian)(flat), float)
    # The nearest positions that obey them, to first order.
    inverse = np.linalg.pinv(jacobian, rcond=1e-3)
    off = np.einsum("mdn,mn->md", inverse, (phi - phi.mean(axis=1, keepdims=True)).reshape(len(flat), -1))
    held = np.einsum("mdn,mnd->md", inverse, jacobian).reshape(-1, count, 2).sum(axis=(0, 2))
    return np.maximum(rest, deviation(off, held))


def judge_trained(
    model: Any,
    data: Resident,
    *,
    reconstruction: float,
    law: float,
    small: float = 0.0,
    tried: Tried | None = None,
) -> str | None:
    """Return what has failed in the whole training, or None: the criteria of its first two stages, at its end.

    Where the dynamics cannot follow, the stage joint may lower its loss by keypoints that leave their parts or stand
    still.

    Args:
        model: after the last stage.
        data: the training data.
        reconstruction: `worst` of `judge_vision`.
        law: `worst` of `judge_dynamics`.
        small: pixels of error that pass there.
        tried: as in `judge_dynamics`.
    """
    seen = judge_vision(model, data, worst=reconstruction)
    return seen or judge_dynamics(model, data, worst=law, small=small, loose=_TIGHT, tried=tried)


def _stands_out(model: Any, data: Resident) -> float:
    """Return by how much frames differ from the background at the best keypoint, as a share of the most; their mean."""
    some = spread(data, COMPARED)
    grid = image_grid(*data.shape[2:4])
    x, y = grid[0, :, 0], grid[:, 0, 1]

    def weights(at: jax.Array, axis: jax.Array) -> jax.Array:
        return jax.nn.softmax(-((at[:, None] - axis[None]) ** 2) / (2 * _WIDE**2), axis=1)

    def one(frame: jax.Array) -> jax.Array:
        differs = jnp.sum((frame - model.estimator.standardise.mean) ** 2, axis=-1)
        place = model.observe(frame).keypoints
        here = jnp.einsum("kr,rc,kc->k", weights(place[:, 1], y), differs, weights(place[:, 0], x))
        return jnp.max(here) / jnp.max(weights(y, y) @ differs @ weights(x, x).T)

    shown = (data.image[i][:: max(1, data.shape[1] * len(some) // _SEEN)] for i in some)
    return float(np.mean([jnp.mean(jax.lax.map(one, frames.astype(jnp.float32) / 255.0)) for frames in shown]))


@eqx.filter_jit
def _rendering_error(model: Any, image: jax.Array) -> jax.Array:
    """Return the squared error of a recording rendered from the keypoints observed in it, mean over frames."""
    frames = image.astype(jnp.float32) / 255.0
    observed = model.observe_clips(frames[None])
    return squared_error(jax.vmap(model.renderer)(observed.keypoints, observed.looks), frames)
