"""Frames a second of a batch of roll-outs with its gradient: RATTLE with 4 sub-steps compared with one step of RK4.

Both alternate in one run, so that the speed of the machine cancels in the ratio. Prints JSON.
"""

import json
import statistics
import time

import equinox as eqx
import jax
import jax.numpy as jnp

from keycld.mechanics import (
    RK4,
    AffineMLPInputMatrix,
    ConstrainedLagrangian,
    Constraints,
    FixedDistance,
    MechanicalDynamics,
    Motion,
    OnLine,
    PointMasses,
    Rattle,
    State,
    SumPotential,
)

BATCH, FRAMES, ROUNDS = 16, 48, 15


@eqx.filter_jit
@eqx.filter_value_and_grad
def fit(dynamics, x, v, u, target):
    """Return the squared error of a batch of roll-outs."""

    def one(x, v, u, target):
        state = State(Motion(x, v), {"constants": dynamics.law.constraint(x)})
        return jnp.mean((dynamics.rollout(state, u, 0.02, FRAMES).x - target) ** 2)

    return jnp.mean(jax.vmap(one)(x, v, u, target))


def main():
    """Time both alternately and print medians."""
    keys = jax.random.split(jax.random.key(0), 4)
    law = ConstrainedLagrangian(
        PointMasses.ones(2),
        SumPotential(jnp.zeros(4), {}),
        AffineMLPInputMatrix(4, 2, key=keys[1]),
        Constraints(("cart", "tip"), (OnLine("cart"), FixedDistance("cart", "tip"))),
    )
    x = jnp.array([[0.0, 0.0, 0.3, 0.4]]) + 0.1 * jax.random.normal(keys[2], (BATCH, 4))
    v = jax.vmap(law.project_velocity)(x, jax.random.normal(keys[3], (BATCH, 4)))
    u, target = jnp.ones((BATCH, 2)), jnp.zeros((BATCH, FRAMES + 1, 4))

    dynamics = {
        "rattle_4_substeps": MechanicalDynamics(law, Rattle(substeps=4)),
        "rk4": MechanicalDynamics(law, RK4()),
    }
    seconds = {name: [] for name in dynamics}
    for round_ in range(ROUNDS + 1):
        for name, each in dynamics.items():
            before = time.perf_counter()
            jax.block_until_ready(fit(each, x, v, u, target))
            if round_ > 0:  # the first round compiles
                seconds[name].append(time.perf_counter() - before)
    median = {name: statistics.median(values) for name, values in seconds.items()}
    result = {
        "bench": "integrators",
        "batch": BATCH,
        "frames": FRAMES,
        "milliseconds": {name: round(1e3 * value, 2) for name, value in median.items()},
        "frames_per_second": {name: round(BATCH * FRAMES / value) for name, value in median.items()},
    }
    print(json.dumps(result | {"ratio": round(median["rk4"] / median["rattle_4_substeps"], 2)}))


if __name__ == "__main__":
    main()
