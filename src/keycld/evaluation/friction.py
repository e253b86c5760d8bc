"""How well the learned friction takes the energy that the true friction takes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.evaluation.acceleration import keypoint_motion, on_constraints
from keycld.models.base import HasLagrangian
from keycld.systems import AbstractSystem, AbstractWatchedMechanism
from keycld.systems.mujoco.loading import import_mujoco

_MOST_STATES = 500
_STEP = 1e-4
# A true rate, 1/s, below which a difference of energies is rounding: some 1e-8 without friction.
_ROUNDING = 1e-6


def friction_rates(
    model: HasLagrangian,
    system: AbstractSystem,
    fit: tuple[Float[np.ndarray, "M K 2"], Float[np.ndarray, "M d"]],
    state: Float[np.ndarray, "N d"],
) -> dict[str, float] | None:
    """Compute the rate at which friction takes energy, learned and true, in the same states.

        rate = mean power that friction takes / (2 · mean kinetic energy)    1/s

    A mass m with the friction −c ẋ has the rate c/m whatever its motion, a hinge c/J; without friction it is zero. The
    learned power is v·∂R/∂v. The true one is −dE/dt of motions without input, which the system simulates. The factor up
    to which a model's masses and forces are known cancels.

    Args:
        model: whose law.
        system: that moves.
        fit: observed keypoints and true states, from which the map from landmarks to keypoints is fitted.
        state: true states; up to 500 of them, evenly spread.

    Returns:
        `found` and `true`, 1/s; None for a system that does not tell its energies, or where MuJoCo is not installed.
    """
    if not isinstance(system, AbstractWatchedMechanism):
        return None
    try:
        import_mujoco()
    except KeycldError:
        return None
    still = np.zeros(len(system.input_names))
    runs = [system.simulate(each, still, 1) for each in state[:: -(-len(state) // _MOST_STATES)]]
    state, derivative = (np.concatenate([run[k] for run in runs]) for k in (2, 3))
    before, after = (sum(system.energies(state + sign * _STEP * derivative)) for sign in (-1, 1))
    kinetic, _ = system.energies(state)
    true = -np.mean(after - before) / (2 * _STEP) / (2 * np.mean(kinetic))
    true = 0.0 if abs(true) < _ROUNDING else true
    x, v = keypoint_motion(system, fit, state, derivative)
    power, double = _power(model, jnp.asarray(x), jnp.asarray(v))
    return {"found": float(np.mean(power) / np.mean(double)), "true": float(true)}


@eqx.filter_jit
def _power(model: HasLagrangian, x: Array, v: Array) -> tuple[Array, Array]:
    """Return the power that friction takes, and twice the kinetic energy, for each motion."""

    def one(x: Array, v: Array) -> tuple[Array, Array]:
        x, v = on_constraints(model, x, v)
        return -jnp.sum(v * model.law.friction(x, v)), 2 * model.law.kinetic_energy(x, v)

    return jax.vmap(one)(x, v)
