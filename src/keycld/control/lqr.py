"""Linear–quadratic regulation about a pose or along a motion, from the linearised learned dynamics.

Everything is in the model's own coordinates z = (x, v) [4K]. A step of the constrained dynamics projects nearby states
onto the constraints, so directions off the constraints have eigenvalues of zero and need no special treatment.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics import AbstractDynamics, Motion, State


class Weights(NamedTuple):
    """Deviations of equal cost (Bryson's rule): Q = diag(1/deviation²), R = 1/deviation².

    Attributes:
        position: of a keypoint's coordinate, image-plane units.
        velocity: of its rate, units/s.
        input: of u.
    """

    position: float
    velocity: float
    input: float

    def state_cost(self, dim: int) -> np.ndarray:
        """Return Q [4K, 4K], where `dim` is 2K."""
        return np.diag(np.repeat([self.position**-2.0, self.velocity**-2.0], dim))


def frame_step(
    dynamics: AbstractDynamics,
    z: Float[Array, "two_dim"],
    u: Float[Array, "l"],
    constants: Float[Array, "n"],
    dt: float,
) -> Float[Array, "two_dim"]:
    """Return z one frame later."""
    state = dynamics.step(State(Motion(*jnp.split(z, 2)), {"constants": constants}), u, dt)
    return jnp.concatenate(state.coordinates)


_jacobians = eqx.filter_jit(jax.jacfwd(frame_step, argnums=(1, 2)))


def stationary_gain(
    dynamics: AbstractDynamics,
    goal: Float[Array, "dim"],
    u: Float[Array, "l"],
    constants: Float[Array, "n"],
    actuators: tuple[int, ...],
    dt: float,
    weights: Weights,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gain K [a, 4K] of u = u* − K (z − z*) that holds a pose, and its cost-to-go S [4K, 4K].

    K minimises Σ (zᵀQz + uᵀRu) of the step linearised at the pose; S solves the discrete Riccati equation.

    Args:
        dynamics: learned.
        goal: x* [2K], image-plane units.
        u: the input u* [l] that holds it.
        constants: of the constraints, [n].
        actuators: positions of the inputs that act.
        dt: seconds between frames.
        weights: costs of deviations.

    Raises:
        KeycldError: those inputs cannot hold the pose.
    """
    z = jnp.concatenate([goal, 0 * goal])
    a, b = _jacobians(dynamics, z, u, constants, dt)
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)[:, list(actuators)]
    cost = np.eye(len(actuators)) / weights.input**2
    try:
        ahead = scipy.linalg.solve_discrete_are(a, b, weights.state_cost(len(goal)), cost)
        gain = np.linalg.solve(cost + b.T @ ahead @ b, b.T @ ahead @ a)
        growth = np.abs(np.linalg.eigvals(a - b @ gain)).max()
        found = f"deviations grow by {growth:.3g} a frame"
    except (np.linalg.LinAlgError, ValueError) as error:
        growth, found = np.inf, str(error)
    if not growth < 1:
        raise KeycldError(
            f"these inputs cannot hold the goal ({found}): choose other actuators, or another goal image."
        )
    return gain, ahead
