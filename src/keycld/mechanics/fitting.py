"""Least squares through the dynamics: initial states of many motions and parameters of the law from observations."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PyTree

from keycld._errors import KeycldError
from keycld.mechanics.dynamics import MechanicalDynamics
from keycld.mechanics.lagrangian import ConstrainedLagrangian
from keycld.mechanics.state import Motion, Scalar, State

# Bounds of the damping, and the least curvature of a direction, as a share of the largest.
_LEAST, _MOST, _FLAT = 1e-6, 1e4, 1e-3
# A fit ends after so many steps in a row that gain less than this share of the cost.
_STALLS, _GAIN = 3, 1e-3


class Fitted(NamedTuple):
    """The result of `fit_motions`.

    Attributes:
        dynamics: the given ones with the fitted parameters.
        initial: the fitted initial states, `[N, dim]` each; a further fit can begin with them.
        paths: positions of the fitted motions at all frames.
        errors: root mean square difference of path and observations of each motion, over the frames of the fit, per
            component.
        cost: the sum that was minimised.
        curvature: second derivatives of the least cost by θ, initial states eliminated, at the last step but one.
    """

    dynamics: MechanicalDynamics
    initial: Motion
    paths: Float[Array, "N T dim"]
    errors: Float[Array, "N"]
    cost: Float[Array, ""]
    curvature: Float[Array, "P P"]

    @property
    def rms(self) -> Float[Array, ""]:
        """Root mean square of the errors of all motions."""
        return jnp.sqrt(jnp.mean(self.errors**2))


def fit_motions(
    dynamics: MechanicalDynamics,
    free: PyTree,
    observed: Float[Array, "N T dim"],
    u: Float[Array, "N *T l"],
    dt: Scalar,
    *,
    frames: int | Int[Array, ""] | None = None,
    active: PyTree | None = None,
    constants: Float[Array, "n"] | None = None,
    initial: Motion | None = None,
    searches: int | Int[Array, ""] = 3,
    iterations: int | Int[Array, ""] = 30,
    scale: float = 0.05,
    chunk: int = 50,
) -> Fitted:
    """Fit the initial state of every motion, and parameters θ common to all, to observations of whole trajectories.

        min over zᵢ, θ of Σᵢₜₖ ρ(xₖ(t; zᵢ, θ) − observedᵢₜₖ),    ρ(e) = s²(√(1 + (e/s)²) − 1)

    by Levenberg–Marquardt with Marquardt's scaling. z = (x₀, v₀) is projected on the constraints. Observation errors
    average out over all frames of a motion, so fitted paths are better estimates of the positions than the
    observations are, and forces act over the whole time instead of between two frames.

    The first steps move initial states alone, the others all unknowns; each motion accepts its own new state. The
    initial states are eliminated motion by motion (Schur complement), so the cost is linear
    in N. From a rough guess, fit growing parts of the trajectories, one call each.

    Derivatives come from the transition matrix A of each frame, ∂(x, v)ₜ₊₁ = Aₜ ∂(x, v)ₜ + Bₜ ∂θ. A is exact. B takes
    the derivative of the acceleration at the two frames as linear between them: an error of (ω dt)², which slows the
    convergence a little and leaves the paths exact, for a fifth of the time. For numbers of the constraints, such as an
    unknown pivot, B is exact. Φ then depends on θ: its constants are the means over the observations for each θ.

    Args:
        dynamics: a `ConstrainedLagrangian` with its integrator, near the solution.
        free: a pytree of bools of the dynamics' shape: which leaves are θ. None at all is allowed.
        observed: observed positions at consecutive frames, image-plane units.
        u: inputs, constant or held per frame.
        dt: seconds between frames.
        frames: how many of the first frames count; None: all.
        active: a pytree of the same shape with 1 for each number of θ that is fitted and 0 for each that stays; None:
            all are fitted. One compiled program serves all choices.
        constants: values of Φ that all motions share; None: for each motion the mean over its observations. Where
            numbers of Φ are free, only whether constants are shared counts: they are the means over all observations.
        initial: initial states to begin with, `[N, dim]` each; None: `rough_states`.
        searches: steps of the initial states alone before the others.
        iterations: the most steps of initial states and θ together. It ends after three in a row that gain less than a
            thousandth of the cost each: from a good guess after 4.
        scale: s, image-plane units; errors above it count linearly.
        chunk: trajectories differentiated at a time.

    Returns:
        The dynamics with the fitted parameters, the initial states, the fitted paths, and their errors.

    Raises:
        KeycldError: for another kind of law.
    """
    law, (count, length, dim) = dynamics.law, observed.shape
    if not isinstance(law, ConstrainedLagrangian):
        raise KeycldError(f"motions are fitted through a ConstrainedLagrangian, not a {type(law).__name__}.")
    parameters, rest = eqx.partition(dynamics, free)
    flat, unravel = ravel_pytree(parameters)
    chosen = jnp.ones_like(flat) if active is None else ravel_pytree(eqx.filter(active, free))[0]
    geometry = _geometry(parameters)
    mask = (jnp.arange(length) < (length if frames is None else frames)).astype(observed.dtype)
    shared = constants is not None
    if constants is None:
        constants = jax.vmap(lambda x: jnp.mean(jax.vmap(law.constraint)(x), axis=0))(observed)
    else:
        constants = jnp.broadcast_to(constants[None, :], (count, constants.shape[0]))
    clock = length * dt / 2  # velocities times this weigh like positions
    size = 2 * dim

    def model(theta: Array) -> MechanicalDynamics:
        return eqx.combine(unravel(theta), rest)

    def fitted_law(theta: Array) -> ConstrainedLagrangian:
        fitted = model(theta).law
        assert isinstance(fitted, ConstrainedLagrangian)
        return fitted

    def kept(theta: Array, x: Array, held: Array) -> Array:
        """Return the constants of the motion with the observations x."""
        if not geometry.size:
            return held
        among = observed.reshape(-1, dim) if shared else x
        return jnp.mean(jax.vmap(fitted_law(theta).constraint)(among), axis=0)

    def projected(z: Array, theta: Array, held: Array) -> Array:
        fitted = fitted_law(theta)
        x = fitted.project_position(z[:dim], held)
        return jnp.concatenate([x, fitted.project_velocity(x, z[dim:] / clock)])

    def motion(z: Array, theta: Array, held: Array, push: Array) -> Motion:
        first = projected(z, theta, held)
        state = State(Motion(first[:dim], first[dim:]), {"constants": held})
        return model(theta).rollout(state, push if push.ndim == 1 else push[: length - 1], dt, length - 1)

    def counted(values: Array) -> Array:
        # What has diverged after the last frame that counts must not spread.
        return jnp.where(mask.reshape(-1, *[1] * (values.ndim - 1)) > 0, values, 0.0)

    def cost(error: Array) -> Array:
        total = jnp.sum(scale**2 * (jnp.sqrt(1 + (counted(error) / scale) ** 2) - 1))
        return jnp.where(jnp.isfinite(total), total, jnp.inf)

    def blocks(z: Array, theta: Array, x: Array, held: Array, push: Array) -> tuple[Array, Array, Array, Array]:
        """Compute matrix, slope and value of the quadratic model of one motion's cost in (z, θ), and its path."""
        start = held
        held = kept(theta, x, start)
        path = motion(z, theta, held, push)
        states, error = jnp.concatenate([path.x, path.v], axis=1), path.x - x
        inputs = jnp.broadcast_to(push[None], (length, push.shape[0])) if push.ndim == 1 else push

        def shaped(numbers: Array) -> tuple[Array, Array]:
            """Return θ with these numbers of the constraints, and the constants."""
            changed = theta.at[geometry].set(numbers)
            return changed, kept(changed, x, start)

        def step(state: Array, push: Array, theta: Array = theta, held: Array = held) -> Array:
            now = State(Motion(state[:dim], state[dim:]), {"constants": held})
            return jnp.concatenate(model(theta).step(now, push, dt).coordinates)

        def accelerate(theta: Array, state: Array, push: Array) -> Array:
            return model(theta).law.acceleration(state[:dim], state[dim:], push)

        transitions = jax.vmap(jax.jacfwd(step))(states[:-1], inputs[:-1])
        first = jnp.concatenate([jax.jacfwd(projected)(z, theta, held), jnp.zeros((size, flat.size))], axis=1)
        slopes = jnp.zeros((length, dim, 0))
        if flat.size:
            slopes = jax.vmap(lambda state, push: jax.jacrev(accelerate)(theta, state, push))(states, inputs)
        here, then = slopes[:-1], slopes[1:]
        pushes = jnp.concatenate([dt**2 / 6 * (2 * here + then), dt / 2 * (here + then)], axis=1)
        pushes = jnp.concatenate([jnp.zeros((length - 1, size, size)), pushes], axis=2)
        if geometry.size:
            numbers, columns = theta[geometry], size + geometry
            first = first.at[:, columns].set(jax.jacfwd(lambda numbers: projected(z, *shaped(numbers)))(numbers))
            exact = jax.jacfwd(
                lambda numbers: jax.vmap(lambda s, u: step(s, u, *shaped(numbers)))(states[:-1], inputs[:-1])
            )
            pushes = pushes.at[:, :, columns].set(exact(numbers))

        def pass_frame(slope: Array, matrices: tuple[Array, Array]) -> tuple[Array, Array]:
            slope = jnp.matmul(matrices[0], slope, precision="highest") + matrices[1]
            return slope, slope[:dim]

        _, later = jax.lax.scan(pass_frame, first, (transitions, pushes))
        slopes = counted(jnp.concatenate([first[None, :dim], later])).reshape(length * dim, -1)
        error = counted(error)
        pull = slopes * jax.lax.rsqrt(1 + (error / scale) ** 2).reshape(-1, 1)
        matrix = jnp.matmul(pull.T, slopes, precision="highest")
        slope = jnp.matmul(pull.T, error.reshape(-1), precision="highest")
        # A motion whose derivatives overflow keeps its state, and θ does not hear of it.
        sound = jnp.all(jnp.isfinite(matrix)) & jnp.all(jnp.isfinite(slope))
        return jnp.where(sound, matrix, 0.0), jnp.where(sound, slope, 0.0), cost(error), path.x

    def each(function, *arrays):
        return jax.lax.map(lambda args: function(*args), arrays, batch_size=min(chunk, count))

    def unfinished(carry: tuple) -> Array:
        *_, stalls, taken = carry
        return (stalls < _STALLS) & (taken < searches + iterations)

    def improve(carry: tuple) -> tuple:
        z, dampings, theta, damping, least, _, _, stalls, taken = carry
        matrix, slope, old, paths = each(
            lambda z, x, held, push: blocks(z, theta, x, held, push), z, observed, constants, u
        )
        inner = _damped(matrix[:, :size, :size], jnp.minimum(dampings, damping))
        mixed = matrix[:, :size, size:]
        by_theta = jnp.linalg.solve(inner, mixed)
        alone = jnp.linalg.solve(inner, slope[:, :size, None])[..., 0]
        schur = matrix[:, size:, size:] - jnp.einsum("nzt,nzs->nts", mixed, by_theta, precision="highest")
        pull = slope[:, size:] - jnp.einsum("nzt,nz->nt", mixed, alone, precision="highest")
        moves = jnp.where(taken < searches, 0.0, chosen)
        curvature = jnp.sum(schur, axis=0)
        change = jnp.linalg.solve(
            _damped(moves[:, None] * curvature * moves[None, :], damping), moves * jnp.sum(pull, axis=0)
        )
        new_theta = theta - change
        new_z = z - alone + jnp.einsum("nzt,t->nz", by_theta, change, precision="highest")

        def price(both: Array, x: Array, held: Array, push: Array) -> tuple[Array, Array]:
            own = kept(new_theta, x, held)
            paths = jax.vmap(lambda z: motion(z, new_theta, own, push).x)(both)
            return jax.vmap(lambda path: cost(path - x))(paths), paths

        prices, new_paths = each(price, jnp.stack([z, new_z], axis=1), observed, constants, u)
        moved = prices[:, 1] < prices[:, 0]
        total, reached = jnp.sum(old), jnp.sum(jnp.min(prices, axis=1))
        better = reached < total
        z = jnp.where((better & moved)[:, None], new_z, z)
        theta = jnp.where(better, new_theta, theta)
        chosen_paths = jnp.where(moved[:, None, None], new_paths[:, 1], new_paths[:, 0])
        paths = jnp.where(better, chosen_paths, paths)
        now = jnp.minimum(reached, total)
        stalls = jnp.where((now < (1 - _GAIN) * least) | (taken < searches), 0, stalls + 1)
        damping = jnp.where(taken < searches, damping, _next_damping(better, damping))
        dampings = _next_damping(moved, dampings)
        return z, dampings, theta, damping, now, curvature, paths, stalls, taken + 1

    start = rough_states(observed, dt) if initial is None else initial
    z = jnp.concatenate([start.x, clock * start.v], axis=1)
    curvature = jnp.zeros((flat.size, flat.size))
    begin = (z, jnp.full(count, 1e-2), flat, jnp.array(1e-2), jnp.array(jnp.inf), curvature, observed, 0, 0)
    begin = jax.tree.map(jnp.asarray, begin)
    z, _, flat, _, _, curvature, paths, _, _ = jax.lax.while_loop(unfinished, improve, begin)
    first = jax.vmap(lambda z, x, held: projected(z, flat, kept(flat, x, held)))(z, observed, constants)
    squares = jax.vmap(lambda error: jnp.sum(counted(error) ** 2))(paths - observed)
    errors = jnp.sqrt(squares / (jnp.sum(mask) * dim))
    total = jnp.sum(jax.vmap(cost)(paths - observed))
    return Fitted(model(flat), Motion(first[:, :dim], first[:, dim:]), paths, errors, total, curvature)


def rough_states(observed: Float[Array, "N T dim"], dt: Scalar) -> Motion:
    """Return positions and velocities `[N, dim]` at frame 0 of a cubic through the first five frames."""
    window = min(5, observed.shape[1])
    powers = np.linalg.pinv(np.vander(np.arange(window), min(4, window), increasing=True))
    x, v = (jnp.einsum("t,ntd->nd", jnp.asarray(row, observed.dtype), observed[:, :window]) for row in powers[:2])
    return Motion(x, v / dt)


def _geometry(parameters: PyTree) -> np.ndarray:
    """Return which entries of the flattened parameters are numbers of the constraints."""
    of_constraints = [
        np.full(leaf.size, ".constraint_function" in jax.tree_util.keystr(path))
        for path, leaf in jax.tree_util.tree_leaves_with_path(parameters)
    ]
    return np.flatnonzero(np.concatenate([np.zeros(0, bool), *of_constraints]))


def _damped(matrix: Array, damping: Array) -> Array:
    """Add the damped diagonal (Marquardt 1963); directions without curvature, such as a factor of M and V, get some."""
    diagonal = jnp.diagonal(matrix, axis1=-2, axis2=-1)
    largest = jnp.max(diagonal, axis=-1, keepdims=True, initial=0.0)
    diagonal = jnp.maximum(diagonal, _FLAT * largest) + 1e-12
    unit = jnp.eye(matrix.shape[-1]).reshape(*[1] * (matrix.ndim - 2), *matrix.shape[-2:])
    return matrix + (damping[..., None] * diagonal)[..., None] * unit


def _next_damping(better: Array, damping: Array) -> Array:
    return jnp.where(better, jnp.maximum(0.2 * damping, _LEAST), jnp.minimum(8 * damping, _MOST))
