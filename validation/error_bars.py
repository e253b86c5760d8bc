"""Do error bars hold what they say? Tracks of known mechanisms with noise, measured as if from a video.

python validation/error_bars.py [--mechanism pendulum] [--draws 50] [--first 0]     results/error-bars.json

A draw has random constants, a random initial state, and observation errors of 0.002 to 0.006 image-plane units (0.06 to
0.2 pixels of a picture of 64). Draws take turns between 10 seconds of 60 frames and 60 seconds of 30 frames. The kinds
of forces are given (gravity in any direction, viscous friction, the cart's spring). The fit begins with parameters that
are wrong by 0.5 %, as a rougher fit leaves them, and with the first ten seconds. Truth is integrated with the
classical Runge-Kutta method in float64 by the true law. Each draw also predicts a new motion of the same mechanism from
ten noisy frames for two seconds.

A line a draw is appended to OUT/error-bars-MECHANISM.jsonl, so that a killed run goes on; the table is made of all.
"""

import argparse
import json
import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from keycld._compile_cache import use_compile_cache
from keycld.evaluation import constants_of
from keycld.mechanics import (
    RK4,
    AbstractPotentialTerm,
    ConstrainedLagrangian,
    CoupledMasses,
    MechanicalDynamics,
    Motion,
    PointMasses,
    Rattle,
    Springs,
    State,
    SumDissipation,
    SumPotential,
    ViscousFriction,
    estimate,
    load_constraints,
    predict_fan,
)
from keycld.models.keycld.law_fit import free_leaves
from keycld.training import environment

SETTINGS = ((10, 60), (60, 30))
MECHANISMS = ("pendulum", "spring", "double-pendulum")
GIVEN, AHEAD = 10, 2.0


def drawn(mechanism, rng):
    """Return a true law, its constants of Φ, a function that draws initial positions, and the true values by name."""
    friction = rng.uniform(0.05, 0.4)
    if mechanism == "spring":
        angle, period = rng.uniform(-0.6, 0.6), rng.uniform(0.7, 2.0)
        along, middle = np.array([np.cos(angle), np.sin(angle)]), rng.uniform(-0.2, 0.2, 2)
        stiffness = (2 * np.pi / period) ** 2
        law = law_of(mechanism, [1.0], -stiffness * middle, friction, springs=stiffness)
        law = eqx.tree_at(lambda law: law.constraint_function.items[0].learned, law, jnp.asarray(angle))
        constants = np.array([np.array([-along[1], along[0]]) @ middle])

        def place():
            return middle + along * rng.choice([-1, 1]) * rng.uniform(0.3, 0.7)

        return (
            law,
            constants,
            place,
            {
                "period_1": period,
                "viscous_rate": friction,
                "line_direction_mass": np.rad2deg(angle),
            },
        )
    pivot, tilt, period = rng.uniform(-0.3, 0.3, 2), rng.uniform(-0.2, 0.2), rng.uniform(1.0, 2.0)
    down = np.array([np.sin(tilt), -np.cos(tilt)])
    if mechanism == "pendulum":
        lengths, masses = [rng.uniform(0.3, 0.7)], [1.0]
    else:
        lengths, masses = list(rng.uniform(0.25, 0.45, 2)), [1.0, rng.uniform(0.4, 1.5)]
    gravity = lengths[0] * (2 * np.pi / period) ** 2
    law = law_of(mechanism, masses, np.concatenate([-m * gravity * down for m in masses]), friction)
    law = eqx.tree_at(lambda law: law.constraint_function.items[0].learned, law, jnp.asarray(pivot))

    def place():
        most = 1.6 if mechanism == "pendulum" else 0.9
        angles = rng.choice([-1, 1], len(lengths)) * rng.uniform(0.4, most, len(lengths)) + tilt
        steps = np.array(lengths)[:, None] * np.stack([np.sin(angles), -np.cos(angles)], axis=1)
        return (pivot + np.cumsum(steps, axis=0)).reshape(-1)

    names = {"pendulum": ("pivot_ball",), "double-pendulum": ("pivot_elbow", "elbow_tip")}[mechanism]
    truth = {
        "pivot_x": pivot[0],
        "pivot_y": pivot[1],
        "viscous_rate": friction,
        "gravity_direction": np.rad2deg(np.arctan2(down[1], down[0])),
        **{f"length_{name}": length for name, length in zip(names, lengths, strict=True)},
    }
    if mechanism == "pendulum":
        return law, np.square(lengths), place, truth | {"period_1": period}
    (l1, l2), (m1, m2) = lengths, masses
    mass = np.array([[(m1 + m2) * l1**2, m2 * l1 * l2], [m2 * l1 * l2, m2 * l2**2]])
    stiffness = gravity * np.diag([(m1 + m2) * l1, m2 * l2])
    squares = np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)
    periods = {f"period_{k + 1}": 2 * np.pi / np.sqrt(square) for k, square in enumerate(squares)}
    return law, np.square(lengths), place, truth | periods | {"mass_ratio_elbow_tip": m1 / m2}


def law_of(mechanism, masses, weight, friction, springs=None):
    """Return a law with weights V = w·x and the same viscous rate for all keypoints."""
    terms: dict[str, AbstractPotentialTerm] = {} if springs is None else {"springs": Springs(jnp.array([[springs]]))}
    viscous = ViscousFriction(jnp.diag(friction * jnp.asarray(masses)))
    return ConstrainedLagrangian(
        PointMasses(jnp.sqrt(jnp.asarray(masses))),
        SumPotential(jnp.asarray(weight), terms),
        None,
        load_constraints(mechanism),
        SumDissipation({"viscous": viscous}),
    )


def simulated(law, constants, x, dt, frames):
    with jax.enable_x64(True):
        start = law.project_position(jnp.asarray(x), jnp.asarray(constants))
        return np.asarray(_roll(law, start, jnp.asarray(dt), frames))


@eqx.filter_jit
def _roll(law, x, dt, frames):
    state = State(Motion(x, jnp.zeros_like(x)), {})
    return MechanicalDynamics(law, RK4(12)).rollout(state, jnp.zeros(0), dt, frames - 1).x


def measured(mechanism, seed):
    """Return one draw: value, sigma and truth of each constant, and the coverage of a prediction."""
    rng = np.random.default_rng(seed)
    seconds, fps = SETTINGS[seed % len(SETTINGS)]
    dt, noise = 1 / fps, rng.uniform(0.002, 0.006)
    with jax.enable_x64(True):
        law, constants, place, truth = drawn(mechanism, rng)
    path = simulated(law, constants, place(), dt, seconds * fps)
    seen = path + noise * rng.standard_normal(path.shape)
    began = time.monotonic()
    start = Motion(jnp.asarray(seen[None, 0]), jnp.zeros((1, seen.shape[1])))
    guess = guessed(mechanism, law, rng)
    nothing = np.zeros((1, 0))
    found = estimate(guess, free_leaves(guess), seen[None, : 10 * fps], nothing, dt, initial=start)
    if seconds > 10:
        with jax.enable_x64(True):
            near, _ = found.unknowns(jnp.asarray(found.eta))
        found = estimate(near, free_leaves(near), seen[None], nothing, dt, initial=found.initial)
    taken = time.monotonic() - began
    constants_found = constants_of(found)
    numbers = {name: [constants_found[name]["value"], constants_found[name]["sigma"], truth[name]] for name in truth}
    again = simulated(law, constants, place(), dt, round(AHEAD * fps))
    given = again[:GIVEN] + noise * rng.standard_normal(again[:GIVEN].shape)
    guess = Motion(given[0], (given[4] - given[0]) / (4 * dt))
    fan = predict_fan(found, given, np.zeros(0), len(again), initial=guess)
    off = np.abs(fan.keypoints.reshape(again.shape) - again) / fan.sigma.reshape(again.shape)
    last = off[-1]
    return {
        "seed": seed,
        "seconds": seconds,
        "fps": fps,
        "noise": noise,
        "noise_found": found.noise.tolist(),
        "taken": round(taken, 1),
        "constants": numbers,
        "fan": [float(np.mean(off[GIVEN:] < limit)) for limit in (1.0, 1.96)],
        "fan_last": [float(np.mean(last < limit)) for limit in (1.0, 1.96)],
    }


def guessed(mechanism, law, rng):
    """Return the true law with parameters that are wrong by about 0.5 %, pivots by 0.003, directions by 0.2 degrees."""

    def off(path, leaf):
        if not eqx.is_inexact_array(leaf):
            return leaf
        size = 0.003 if "learned" in jax.tree_util.keystr(path) else 0.005 * np.abs(leaf)
        return jnp.asarray(leaf + size * rng.standard_normal(leaf.shape), jnp.float32)

    rough = jax.tree_util.tree_map_with_path(off, law)
    if len(law.masses) > 1:
        rough = eqx.tree_at(lambda law: law.mass, rough, CoupledMasses.ones(2).nearest(np.asarray(rough.mass.matrix)))
    return MechanicalDynamics(rough, Rattle(4))


def table(draws):
    """Return shares of draws whose truth lies in the 68 and 95 % intervals, and relative errors."""
    found = {}
    for name in draws[0]["constants"]:
        rows = [d["constants"][name] for d in draws if d["constants"][name][1] is not None]
        value, sigma, truth = np.array(rows, float).T
        off = np.abs(value - truth)
        share = off / np.abs(truth)
        found[name] = {
            "n": len(rows),
            "not_identifiable": len(draws) - len(rows),
            "covers_68": round(float(np.mean(off < sigma)), 3),
            "covers_95": round(float(np.mean(off < 1.96 * sigma)), 3),
            "median_error_percent": round(100 * float(np.median(share)), 4),
            "largest_error_percent": round(100 * float(np.max(share)), 4),
        }
    fans = {f"fan_{k}": round(float(np.mean([d["fan"][i] for d in draws])), 3) for i, k in enumerate((68, 95))}
    ends = {f"fan_end_{k}": round(float(np.mean([d["fan_last"][i] for d in draws])), 3) for i, k in enumerate((68, 95))}
    every = [row for d in draws for row in d["constants"].values() if row[1] is not None]
    z = np.array([abs(value - truth) / sigma for value, sigma, truth in every])
    pooled = {"covers_68": round(float(np.mean(z < 1)), 3), "covers_95": round(float(np.mean(z < 1.96)), 3)}
    return {"draws": len(draws), "all_constants": pooled, **fans, **ends, "constants": found}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mechanism", choices=MECHANISMS, action="append")
    parser.add_argument("--draws", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--lines", type=Path, default=Path("runs/error-bars"))
    parser.add_argument("--out", type=Path, default=Path("results/error-bars.json"))
    options = parser.parse_args()
    use_compile_cache()
    options.lines.mkdir(parents=True, exist_ok=True)
    tables = {}
    for mechanism in options.mechanism or MECHANISMS:
        path = options.lines / f"error-bars-{mechanism}.jsonl"
        done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
        known = {draw["seed"] for draw in done}
        for seed in range(options.first, options.first + options.draws):
            if seed not in known:
                done.append(measured(mechanism, seed))
                with path.open("a") as file:
                    print(json.dumps(done[-1]), file=file)
                z = {k: round((v - t) / s, 1) if s else None for k, (v, s, t) in done[-1]["constants"].items()}
                print(mechanism, seed, done[-1]["taken"], done[-1]["fan"], z, flush=True)
        tables[mechanism] = table(done)
    record = {"command": "python validation/error_bars.py", "seeds": [options.first, options.first + options.draws - 1]}
    options.out.write_text(json.dumps(record | {"machine": environment(), "mechanisms": tables}, indent=1) + "\n")
    print(json.dumps(tables, indent=1))


if __name__ == "__main__":
    main()
