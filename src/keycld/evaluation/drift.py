"""How well a model keeps what physics keeps: energy without input and friction, and the constraints."""

from typing import Any

import numpy as np
from jaxtyping import Float


def energy_drift(
    kinetic: Float[np.ndarray, "N T"], potential: Float[np.ndarray, "N T"]
) -> tuple[dict[str, Any], Float[np.ndarray, "N T"]]:
    """Compute the relative change of T + V along roll-outs without input.

    |E(t) − E(0)| / E*, where E* is the mean over roll-outs of the largest |T| each reaches: the energy that moves. (A
    learned T may be negative.) V is known only up to a constant, so E itself cannot be the scale. Good values without
    friction, which takes energy: below 1e-2 over 50 frames.

    Returns:
        scores: `scale` E* in the model's own unit, `mean` and `worst` over the roll-outs of the largest
            change in each.
        drift: `[N, T]`.
    """
    energy = kinetic + potential
    scale = float(np.mean(np.abs(kinetic).max(axis=1)))
    drift = np.abs(energy - energy[:, :1]) / max(scale, 1e-30)
    largest = drift.max(axis=1)
    return {"scale": scale, "mean": float(np.mean(largest)), "worst": float(np.max(largest))}, drift


def constraint_drift(deviation: Float[np.ndarray, "N T"]) -> dict[str, float]:
    """Return mean and worst of the largest |Φ(x) − constants| of each roll-out, in the constraint's unit."""
    largest = deviation.max(axis=1)
    return {"mean": float(np.mean(largest)), "worst": float(np.max(largest))}
