"""What a controlled flight came to: success, effort, timing, passivity."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from keycld.control.energy_shaping import AbstractShaping
from keycld.control.loop import Flight
from keycld.control.pilot import Pilot
from keycld.evaluation import Evaluation
from keycld.mechanics import ConstrainedLagrangian
from keycld.systems import AbstractMujocoSystem

TOLERANCE = np.radians(10.0)
HOLD = 1.0
_SHORT = 1e-4
"""Seconds, to take a rate of change over."""


def upright(system: AbstractMujocoSystem, state: np.ndarray) -> Any:
    """Whether all links are within 10° of upright and all keypoints in the picture, `[...]`, for states `[..., d]`."""
    stands = np.all(np.abs(system.tilts(state)) <= TOLERANCE, axis=-1)
    return stands & np.all(np.abs(system.landmarks(state)) <= 1.0, axis=(-2, -1))


def at_goal(flight: Flight, goal: np.ndarray, reach: float = 0.1) -> np.ndarray:
    """Whether all keypoints were believed within `reach` image-plane units of the goal, [N, T]."""
    return np.all(np.abs(flight.x - goal) <= reach, axis=-1)


def outcome(
    flight: Flight,
    system: AbstractMujocoSystem,
    pilot: Pilot,
    goal: np.ndarray,
    picture: np.ndarray,
    *,
    stands: bool,
    settings: dict[str, Any],
) -> Evaluation:
    """Scores and arrays of a flight, to be stored with `save_evaluation`.

    A success keeps the goal during the whole last second: for `stands`, every link's true angle within 10° of upright
    and in view; otherwise the believed keypoints within 0.1 image-plane units of the goal's.

    Args:
        flight: what happened.
        system: that flew.
        pilot: that controlled.
        goal: x* [2K].
        picture: of the goal.
        stands: whether the goal is the upright pose.
        settings: to be noted.
    """
    good = np.asarray(upright(system, flight.state[:, 1:]) if stands else at_goal(flight, goal))
    last = max(1, round(HOLD / flight.dt))
    success = np.all(good[:, -last:], axis=1)
    held = np.array([_settled(each) for each in good])
    law: ConstrainedLagrangian = pilot.model.law  # pyright: ignore[reportAttributeAccessIssue]
    scores: dict[str, Any] = {
        **settings,
        "system": system.name,
        "dt": flight.dt,
        "n": len(good),
        "successes": int(success.sum()),
        "success": success,
        "settled_seconds": [float(k) * flight.dt if k < good.shape[1] else None for k in held],
        "worst_tilt_last_second_degrees": np.degrees(np.abs(system.tilts(flight.state[:, -last:])).max(axis=(1, 2))),
        "largest_input": np.abs(flight.input).max(axis=(0, 1)),
        "mean_square_input": np.mean(flight.input**2, axis=(0, 1)),
        "mean_mass": float(np.mean(law.masses)),
        "frames_not_arrived": int((~flight.arrived).sum()),
        "step": {
            "median_ms": 1e3 * float(np.median(flight.step_seconds)),
            "p99_ms": 1e3 * float(np.quantile(flight.step_seconds, 0.99)),
            "worst_ms": 1e3 * float(flight.step_seconds.max()),
            "period_ms": 1e3 * flight.dt,
            "missed": int(flight.missed.sum()),
            "frames": len(flight.missed),
        },
    }
    arrays: dict[str, Any] = {
        "state": flight.state,
        "input": flight.input.astype(np.float32),
        "x": flight.x,
        "v": flight.v,
        "arrived": flight.arrived,
        "frames": flight.frames,
        "goal": np.asarray(goal),
        "goal_frame": picture,
        "step_seconds": flight.step_seconds,
        "missed": flight.missed,
        "tilts": system.tilts(flight.state),
        "good": good,
    }
    if isinstance(pilot.controller, AbstractShaping):
        scores["passivity"], energies = _passivity(pilot.controller, flight, system)
        arrays |= energies
    return Evaluation(scores, arrays)


def _settled(good: np.ndarray) -> int:
    """The first frame from which all are good; their number if the last is not."""
    bad = np.flatnonzero(~good)
    return int(bad[-1]) + 1 if len(bad) else 0


def _passivity(
    controller: AbstractShaping, flight: Flight, system: AbstractMujocoSystem
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """How T + V_d behaves along the true motion, by the learned energies: in a passive loop it never rises."""
    motion, error = _keypoints(flight, system)
    x, v, u = (jnp.asarray(each, jnp.float32) for each in (*motion, flight.input))
    found = jax.jit(jax.vmap(jax.vmap(controller.energies)))(x, v, u)
    arrays = {name: np.asarray(value) for name, value in found._asdict().items()}
    total = arrays["kinetic"] + arrays["desired"]
    largest = np.max(total, axis=1)
    rise = np.max(total - np.minimum.accumulate(total, axis=1), axis=1) / largest
    return {
        "largest_rise_median": float(np.median(rise)),
        "largest_rise_worst": float(np.max(rise)),
        "falling_frames": float(np.mean(np.diff(total, axis=1) <= 0)),
        "left_at_the_end_median": float(np.median(total[:, -1] / largest)),
        "keypoint_error": error,
    }, arrays


def _keypoints(flight: Flight, system: AbstractMujocoSystem) -> tuple[tuple[np.ndarray, np.ndarray], float]:
    """Where the model's keypoints truly were, and how fast, [N, T, 2K]; and how far the pilot believed them, rms.

    A keypoint lies anywhere on a moving part. The affine map from true landmarks that fits the believed positions best,
    in the frames with something seen and all landmarks in view, says where. Believed velocities will not do: a third
    of a pixel of error in one frame may be more kinetic energy than the system has.
    """
    state = flight.state[:, :-1]
    place, rate = np.split(state, 2, axis=-1)
    ahead, behind = (system.landmarks(np.concatenate([place + h * rate, rate], axis=-1)) for h in (_SHORT, -_SHORT))
    marks = system.landmarks(state)
    seen = np.all(np.abs(marks) <= 1.0, axis=(-2, -1)) & np.maximum.accumulate(flight.arrived, axis=1)
    seen = seen if seen.any() else ~seen
    marks = marks.reshape(*state.shape[:2], -1)
    known = np.concatenate([marks, np.ones_like(marks[..., :1])], axis=-1)
    fit = np.linalg.lstsq(known[seen], flight.x[seen], rcond=None)[0]
    x, v = known @ fit, ((ahead - behind) / (2 * _SHORT)).reshape(marks.shape) @ fit[:-1]
    return (x, v), float(np.sqrt(2 * np.mean((x - flight.x)[seen] ** 2)))
