"""The worth of a force as training computes it, next to the rise of the cost when motions are fitted without the force.

python validation/worth_of_forces.py > FILE.jsonl     results/worth-of-forces.json

Motions of ten seconds are integrated, errors are added to the keypoints, and a law with the forces that act is fitted.
`select_terms` then says what each is worth, from the curvature of that fit alone. The same is measured by fits without
it. Masses follow by a share only, or a shrinking mass could take the place of any force. So large worths are smaller
than those of the fits; only those near what a force needs, 0.05 to 0.5, must agree.
"""

import json
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from keycld.mechanics import (
    Constraints,
    DistanceToPoint,
    FixedDistance,
    MechanicalDynamics,
    OnLine,
    terms_of,
    with_terms,
)
from keycld.models import Scene, config_for
from keycld.models.keycld import law_fit
from keycld.models.keycld.model import KeyCLD
from keycld.models.keycld.selection import Tried, select_terms
from keycld.models.keycld.tracks import Tracks

DT, FRAMES = 1 / 30, 300
TIME = DT * np.arange(FRAMES)
ERRORS = (3e-5, 3e-4, 3e-3)


def cart(rate: float) -> np.ndarray:
    """x'' = −16 x − γ x'."""
    x = 0.6 * np.exp(-rate / 2 * TIME) * np.sin(np.sqrt(16 - rate**2 / 4) * TIME + 1)
    return np.stack([x, 0 * x], axis=1)


def pendulum(rate: float) -> np.ndarray:
    """φ'' = −12 sin φ − γ φ'."""
    angle = _integrated(lambda y: [y[1], -12 * np.sin(y[0]) - rate * y[1]], [1.2, 0])[0]
    return 0.7 * np.stack([np.sin(angle), -np.cos(angle)], axis=1)


def double_pendulum(rate: float) -> np.ndarray:
    """Point masses of 1 and 0.7 on links of 0.35 and 0.3, with friction of the hinges."""
    heavy, light, upper, lower, gravity = 1.0, 0.7, 0.35, 0.3, 6.0

    def slope(y: np.ndarray) -> np.ndarray:
        a, b, wa, wb = y
        mixed = light * upper * lower * np.cos(a - b)
        mass = np.array([[(heavy + light) * upper**2, mixed], [mixed, light * lower**2]])
        turn = light * upper * lower * np.sin(a - b)
        weight = gravity * np.array([(heavy + light) * upper * np.sin(a), light * lower * np.sin(b)])
        friction = rate * np.array([2 * wa - wb, wb - wa])
        force = np.array([-turn * wb**2, turn * wa**2]) - weight - friction
        return np.array([wa, wb, *np.linalg.solve(mass, force)])

    a, b = _integrated(slope, [1.0, 0.5, 0, 0])[:2]
    elbow = upper * np.stack([np.sin(a), -np.cos(a)], axis=1)
    return np.concatenate([elbow, elbow + lower * np.stack([np.sin(b), -np.cos(b)], axis=1)], axis=1)


class Case(NamedTuple):
    """A motion, its constraints, and the forces that are fitted."""

    motion: Callable[[float], np.ndarray]
    rate: float
    constraints: Constraints
    kinds: tuple[str, ...]


RAIL = Constraints(("cart",), (OnLine("cart"),))
HINGE = Constraints(("bob",), (DistanceToPoint("bob"),))
HINGES = Constraints(("elbow", "tip"), (DistanceToPoint("elbow"), FixedDistance("elbow", "tip")))
CASES = (
    *(Case(cart, rate, RAIL, ("springs", "viscous")) for rate in (0.5, 0.02, 0.0)),
    *(Case(pendulum, rate, HINGE, ("viscous",)) for rate in (0.1, 0.005, 0.0)),
    *(Case(double_pendulum, rate, HINGES, ("joints", "viscous")) for rate in (0.02, 0.002)),
)


def main():
    for case in CASES:
        for error in ERRORS:
            print(json.dumps(compared(case, error)), flush=True)


def compared(case: Case, error: float) -> dict:
    """Return the worth of each force, by curvature and by fits without it."""
    path = case.motion(case.rate)
    seen = path + error * np.random.default_rng(0).standard_normal(path.shape)
    config = config_for("keycld", "clip", constraints=case.constraints)
    model = config.build(Scene(64, 64, 0, FRAMES, DT, 1), jax.random.key(0))
    assert isinstance(model, KeyCLD) and isinstance(model.dynamics, MechanicalDynamics)
    tried = Tried(case.kinds, worth=0.05, takes=True)
    tracks = Tracks(jnp.asarray(seen[None], jnp.float32), jnp.zeros((1, 0)), jnp.array(DT), None, among=case.kinds)
    fitted = law_fit.fit_from_nothing(model.dynamics, case.kinds, tracks)
    left, worth = select_terms(fitted, tracks, tried)
    law = law_fit.lagrangian(fitted.dynamics)
    without = {}
    for kind in case.kinds:
        terms = {name: term for name, term in terms_of(law).items() if name != kind}
        near = law_fit.fit_law(law_fit.with_law(fitted.dynamics, with_terms(law, terms)), tracks, fitted)
        cheaper = law_fit.cheapest([near, law_fit.climb(near.dynamics, tracks)])
        without[kind] = float(cheaper.cost / fitted.cost) - 1
    return {
        "motion": case.motion.__name__,
        "rate": case.rate,
        "error": error,
        "rms": float(f"{float(fitted.rms):.3g}"),
        "kept": sorted(terms_of(law_fit.lagrangian(left))),
        "worth": {kind: float(f"{share:.3g}") for kind, share in worth.items()},
        "by_fits": {kind: float(f"{share:.3g}") for kind, share in without.items()},
    }


def _integrated(slope: Callable[[np.ndarray], object], begin: list[float]) -> np.ndarray:
    found = solve_ivp(lambda _, y: slope(y), (0, TIME[-1]), begin, t_eval=TIME, rtol=1e-10, atol=1e-12)
    return found.y


if __name__ == "__main__":
    main()
