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
        scores["passivity"], energies = _passivity(pilot.controller, flight)
        arrays |= energies
    return Evaluation(scores, arrays)


def _settled(good: np.ndarray) -> int:
    """The first frame from which all are good; their number if the last is not."""
    bad = np.flatnonzero(~good)
    return int(bad[-1]) + 1 if len(bad) else 0


def _passivity(controller: AbstractShaping, flight: Flight) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """How the believed T + V_d behaves: in a passive loop it never rises."""
    x, v, u = (jnp.asarray(each, jnp.float32) for each in (flight.x, flight.v, flight.input))
    found = jax.jit(jax.vmap(jax.vmap(controller.energies)))(x, v, u)
    arrays = {name: np.asarray(value) for name, value in found._asdict().items()}
    total = arrays["kinetic"] + arrays["desired"]
    lowest = np.minimum.accumulate(total, axis=1)
    # Two frames on: the first ones have no velocity yet.
    rise = np.max((total - lowest)[:, 2:], axis=1) / np.max(total, axis=1)
    return {
        "largest_rise_median": float(np.median(rise)),
        "largest_rise_worst": float(np.max(rise)),
        "falling_frames": float(np.mean(np.diff(total[:, 2:], axis=1) <= 0)),
        "left_at_the_end_median": float(np.median(total[:, -1] / np.max(total, axis=1))),
    }, arrays
