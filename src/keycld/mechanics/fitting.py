"""Least squares through the dynamics: initial states of many motions and parameters of the law from observations."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree

from keycld._errors import KeycldError
from keycld.mechanics.dynamics import MechanicalDynamics, joining_velocity
from keycld.mechanics.lagrangian import ConstrainedLagrangian
from keycld.mechanics.state import Motion, Scalar, State


class Fitted(NamedTuple):
    """The result of `fit_motions`.

    Attributes:
        dynamics: the given ones with the fitted parameters.
        paths: positions of the fitted motions at all frames.
        rms: root mean square difference of paths and observations, per component.
    """

    dynamics: MechanicalDynamics
    paths: Float[Array, "N T dim"]
    rms: Float[Array, ""]


def fit_motions(
    dynamics: MechanicalDynamics,
    free: PyTree,
    observed: Float[Array, "N T dim"],
    u: Float[Array, "N *T l"],
    dt: Scalar,
    *,
    horizons: tuple[int, ...],
    constants: Float[Array, "n"] | None = None,
    starts: int = 3,
    iterations: int = 6,
    scale: float = 0.05,
    chunk: int = 50,
) -> Fitted:
    """Fit the initial state of every motion, and parameters θ common to all, to observations of whole trajectories.

        min over zᵢ, θ of Σᵢₜₖ ρ(xₖ(t; zᵢ, θ) − observedᵢₜₖ),    ρ(e) = s²(√(1 + (e/s)²) − 1)

    by Levenberg–Marquardt. z = (x₀, v₀) is projected on the constraints. Observation errors average out over all frames
    of a motion, so fitted paths are better estimates of the positions than the observations are, and forces act over
    the whole time instead of between two frames.
    The initial states are eliminated trajectory by trajectory (Schur complement), so the cost is linear in N.

    Args:
        dynamics: a `ConstrainedLagrangian` with its integrator, near the solution.
        free: a pytree of bools of the dynamics' shape: which leaves are θ. None at all is allowed.
        observed: observed positions at consecutive frames, image-plane units.
        u: inputs, constant or held per frame.
        dt: seconds between frames.
        horizons: numbers of frames used while only initial states are fitted, growing, the last one at most T.
        constants: values of Φ that all motions share; None: for each motion the mean over its observations.
        starts: iterations over initial states at each horizon.
        iterations: over initial states and θ together, all frames.
        scale: s, image-plane units; errors above it count linearly.
        chunk: trajectories differentiated at a time.

    Returns:
        The dynamics with the fitted parameters, the fitted paths, and their error.

    Raises:
        KeycldError: for another kind of law.
    """
    law, (count, length, dim) = dynamics.law, observed.shape
    if not isinstance(law, ConstrainedLagrangian):
        raise KeycldError(f"motions are fitted through a ConstrainedLagrangian, not a {type(law).__name__}.")
    parameters, rest = eqx.partition(dynamics, free)
    flat, unravel = ravel_pytree(parameters)
    if constants is None:
        constants = jax.vmap(lambda x: jnp.mean(jax.vmap(law.constraint)(x), axis=0))(observed)
    else:
        constants = jnp.broadcast_to(constants[None, :], (count, constants.shape[0]))
    clock = length * dt / 2  # velocities times this weigh like positions

    def path(z: Array, theta: Array, held: Array, push: Array) -> Array:
        model = eqx.combine(unravel(theta), rest)
        x = model.law.project_position(z[:dim], held)
        v = model.law.project_velocity(x, z[dim:] / clock)
        inputs = push if push.ndim == 1 else push[: length - 1]
        return model.rollout(State(Motion(x, v), {"constants": held}), inputs, dt, length - 1).x

    def first_guess(x: Array, held: Array, push: Array) -> Array:
        first, second = law.project_position(x[0], held), law.project_position(x[1], held)
        first_input = push if push.ndim == 1 else push[0]
        v = joining_velocity(dynamics, first, second, {"constants": held}, first_input, dt)
        return jnp.concatenate([first, clock * v])

    def cost(error: Array, mask: Array) -> Array:
        return jnp.sum(mask[:, None] * scale**2 * (jnp.sqrt(1 + (error / scale) ** 2) - 1))

    def pieces(z: Array, theta: Array, x: Array, held: Array, push: Array, mask: Array, together: bool) -> Any:
        """Compute the blocks of the normal equations of one trajectory."""
        error = path(z, theta, held, push) - x
        weight = (mask[:, None] * jax.lax.rsqrt(1 + (error / scale) ** 2)).reshape(-1)
        error = error.reshape(-1)
        by_z = jax.jacfwd(path)(z, theta, held, push).reshape(-1, 2 * dim)
        pull = by_z * weight[:, None]
        zz = jnp.matmul(pull.T, by_z, precision="highest")
        zr = jnp.matmul(pull.T, error, precision="highest")
        if not together:
            return zz, zr
        by_theta = jax.jacfwd(path, argnums=1)(z, theta, held, push).reshape(-1, flat.size)
        zt = jnp.matmul(pull.T, by_theta, precision="highest")
        tt = jnp.matmul((by_theta * weight[:, None]).T, by_theta, precision="highest")
        tr = jnp.matmul((by_theta * weight[:, None]).T, error, precision="highest")
        return zz, zr, zt, tt, tr

    def each(function, *arrays):
        return jax.lax.map(lambda args: function(*args), arrays, batch_size=min(chunk, count))

    def damped(matrix: Array, damping: Array) -> Array:
        size = matrix.shape[-1]
        return matrix + (damping * jnp.trace(matrix) / size + 1e-12) * jnp.eye(size)

    def fit_initial_states(carry, frames):
        z, damping, theta = carry
        mask = (jnp.arange(length) < frames).astype(observed.dtype)

        def one(z, damping, x, held, push):
            zz, zr = pieces(z, theta, x, held, push, mask, False)
            trial = z - jnp.linalg.solve(damped(zz, damping), zr)
            old = cost(path(z, theta, held, push) - x, mask)
            better = cost(path(trial, theta, held, push) - x, mask) < old
            return jnp.where(better, trial, z), jnp.where(better, 0.2 * damping, 5 * damping)

        z, damping = each(one, z, damping, observed, constants, u)
        return (z, damping, theta), None

    def fit_all(carry, _):
        z, theta, damping = carry
        mask = jnp.ones(length, observed.dtype)
        zz, zr, zt, tt, tr = each(
            lambda z, x, held, push: pieces(z, theta, x, held, push, mask, True), z, observed, constants, u
        )
        zz = jax.vmap(lambda m: damped(m, damping))(zz)
        inverse_zt, inverse_zr = jnp.linalg.solve(zz, zt), jnp.linalg.solve(zz, zr[..., None])[..., 0]
        schur = jnp.sum(tt - jnp.einsum("nzt,nzs->nts", zt, inverse_zt, precision="highest"), axis=0)
        slope = jnp.sum(tr - jnp.einsum("nzt,nz->nt", zt, inverse_zr, precision="highest"), axis=0)
        change = jnp.linalg.solve(damped(schur, damping), slope)
        new_theta = theta - change
        new_z = z - inverse_zr + jnp.einsum("nzt,t->nz", inverse_zt, change, precision="highest")
        whole = lambda z, theta: jnp.sum(  # noqa: E731
            each(lambda z, x, held, push: cost(path(z, theta, held, push) - x, mask), z, observed, constants, u)
        )
        better = whole(new_z, new_theta) < whole(z, theta)
        pick = lambda new, old: jnp.where(better, new, old)  # noqa: E731
        return (pick(new_z, z), pick(new_theta, theta), jnp.where(better, 0.2 * damping, 10 * damping)), None

    z = each(first_guess, observed, constants, u)
    growing = jnp.repeat(jnp.array(horizons), starts)
    (z, _, _), _ = jax.lax.scan(fit_initial_states, (z, jnp.full(count, 1e-2), flat), growing)
    if flat.size:
        (z, flat, _), _ = jax.lax.scan(fit_all, (z, flat, jnp.array(1e-3)), length=iterations)
    paths = each(lambda z, held, push: path(z, flat, held, push), z, constants, u)
    fitted = eqx.combine(unravel(flat), rest)
    return Fitted(fitted, paths, jnp.sqrt(jnp.mean((paths - observed) ** 2)))
