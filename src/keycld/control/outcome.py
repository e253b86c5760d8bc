"""Scores of a closed-loop run: success, effort, timing, passivity."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from keycld.control.agent import Agent
from keycld.control.closed_loop import ClosedLoopRun
from keycld.control.shaping import AbstractShaping
from keycld.evaluation import Evaluation
from keycld.systems import AbstractMujocoSystem

TOLERANCE = np.radians(10.0)
"""The largest tilt of a link that counts as upright."""
HOLD = 1.0
"""Seconds that the goal is to be kept at the end."""
_SHORT = 1e-4
"""Seconds, step of a numerical derivative."""


def upright(system: AbstractMujocoSystem, state: np.ndarray) -> Any:
    """Return whether all links are within 10° of upright and all landmarks in view, `[...]`, for states `[..., d]`."""
    stands = np.all(np.abs(system.tilts(state)) <= TOLERANCE, axis=-1)
    return stands & np.all(np.abs(system.landmarks(state)) <= 1.0, axis=(-2, -1))


def at_goal(run: ClosedLoopRun, goal: np.ndarray, reach: float = 0.1) -> np.ndarray:
    """Return whether all keypoints are estimated within `reach` image-plane units of the goal, [N, T]."""
    return np.all(np.abs(run.x - goal) <= reach, axis=-1)


def outcome(
    run: ClosedLoopRun,
    system: AbstractMujocoSystem,
    agent: Agent,
    inputs: tuple[int, ...],
    goal: np.ndarray,
    picture: np.ndarray,
    *,
    to_upright: bool,
    settings: dict[str, Any],
) -> Evaluation:
    """Compute scores and arrays of a closed-loop run, to be stored with `save_evaluation`.

    A success keeps the goal during the whole last second. With `to_upright`, every link's true angle is within 10° of
    upright and in view; otherwise the estimated keypoints are within 0.1 image-plane units of the goal's.

    Args:
        run: of the closed loop.
        system: that was controlled.
        agent: that controlled it.
        inputs: which of the system's inputs the agent gave, in its order.
        goal: x* [2K], image-plane units.
        picture: of the goal, uint8 [H, W, 3].
        to_upright: whether the goal is the upright pose.
        settings: stored with the scores.
    """
    # The true state is known at the end of the last frame too.
    good = np.asarray(upright(system, run.state) if to_upright else at_goal(run, goal))
    last = max(1, round(HOLD / run.dt))
    success = np.all(good[:, -last:], axis=1)
    held = np.array([_settled(each) for each in good])
    scores: dict[str, Any] = {
        **settings,
        "system": system.name,
        "dt": run.dt,
        "n": len(good),
        "successes": int(success.sum()),
        "success": success,
        "settled_seconds": [float(k) * run.dt if k < good.shape[1] else None for k in held],
        "worst_tilt_last_second_degrees": np.degrees(np.abs(system.tilts(run.state[:, -last:])).max(axis=(1, 2))),
        "largest_input": np.abs(run.input).max(axis=(0, 1)),
        "mean_square_input": np.mean(run.input**2, axis=(0, 1)),
        "mean_mass": float(np.mean(agent.estimator.law.masses)),
        "frames_not_arrived": int((~run.arrived).sum()),
        "step": {
            "median_ms": 1e3 * float(np.median(run.step_seconds)),
            "p99_ms": 1e3 * float(np.quantile(run.step_seconds, 0.99)),
            "worst_ms": 1e3 * float(run.step_seconds.max()),
            "period_ms": 1e3 * run.dt,
            "missed": int(run.missed.sum()),
            "frames": len(run.missed),
        },
    }
    arrays: dict[str, Any] = {
        "state": run.state,
        "input": run.input.astype(np.float32),
        "x": run.x,
        "v": run.v,
        "arrived": run.arrived,
        "frames": run.frames,
        "goal": np.asarray(goal),
        "goal_frame": picture,
        "step_seconds": run.step_seconds,
        "missed": run.missed,
        "tilts": system.tilts(run.state),
        "good": good[:, : run.input.shape[1]],
    }
    if isinstance(agent.controller, AbstractShaping):
        scores["passivity"], energies = _passivity(agent.controller, run, system, inputs)
        arrays |= energies
    return Evaluation(scores, arrays)


def _settled(good: np.ndarray) -> int:
    """Return the first frame from which all are good; their number if the last is not."""
    bad = np.flatnonzero(~good)
    return int(bad[-1]) + 1 if len(bad) else 0


def _passivity(
    controller: AbstractShaping, run: ClosedLoopRun, system: AbstractMujocoSystem, inputs: tuple[int, ...]
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Compute how the learned T + V_d changes along the true motion: in a passive loop it never rises."""
    motion, error = _keypoints(run, system)
    x, v, u = (jnp.asarray(each, jnp.float32) for each in (*motion, run.input[..., list(inputs)]))
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


def _keypoints(run: ClosedLoopRun, system: AbstractMujocoSystem) -> tuple[tuple[np.ndarray, np.ndarray], float]:
    """Return the true positions and velocities of the model's keypoints, [N, T, 2K], and the estimates' rms error.

    A keypoint lies anywhere on a moving part. The affine map from the true landmarks that fits the estimated positions
    best says where, in the frames with an observation and all landmarks in view. Estimated velocities cannot serve: an
    error of a third of a pixel in one frame may be more kinetic energy than the system has.
    """
    state = run.state[:, :-1]
    place, rate = np.split(state, 2, axis=-1)
    ahead, behind = (system.landmarks(np.concatenate([place + h * rate, rate], axis=-1)) for h in (_SHORT, -_SHORT))
    marks = system.landmarks(state)
    visible = np.all(np.abs(marks) <= 1.0, axis=(-2, -1)) & np.maximum.accumulate(run.arrived, axis=1)
    visible = visible if visible.any() else ~visible
    marks = marks.reshape(*state.shape[:2], -1)
    known = np.concatenate([marks, np.ones_like(marks[..., :1])], axis=-1)
    fit = np.linalg.lstsq(known[visible], run.x[visible], rcond=None)[0]
    x, v = known @ fit, ((ahead - behind) / (2 * _SHORT)).reshape(marks.shape) @ fit[:-1]
    return (x, v), float(np.sqrt(2 * np.mean((x - run.x)[visible] ** 2)))
