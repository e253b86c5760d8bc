"""Least squares through the dynamics: initial states of many motions and parameters of the law from observations."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PyTree

from keycld._errors import KeycldError
from keycld.mechanics.dynamics import MechanicalDynamics
from keycld.mechanics.lagrangian import ConstrainedLagrangian
from keycld.mechanics.motion_cost import MotionCost, motion_cost
from keycld.mechanics.own_parameters import Own
from keycld.mechanics.state import Motion, Scalar

# Bounds of the damping, and the least curvature of a direction, as a share of the largest.
_LEAST, _MOST, _FLAT = 1e-6, 1e4, 1e-3
# A fit ends after so many steps in a row that gain less than this share of the cost, and were expected to.
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
        own: fitted own parameters of each motion; None where there are none.
        followed: whether θ was fitted to each motion.
    """

    dynamics: MechanicalDynamics
    initial: Motion
    paths: Float[Array, "N T dim"]
    errors: Float[Array, "N"]
    cost: Float[Array, ""]
    curvature: Float[Array, "P P"]
    own: Float[Array, "N S"] | None
    followed: Bool[Array, "N"]

    @property
    def rms(self) -> Float[Array, ""]:
        """Root mean square of the errors of the motions that θ was fitted to."""
        return jnp.sqrt(jnp.mean(self.errors**2, where=self.followed))


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
    own: Own | None = None,
    followed: Bool[Array, "N"] | None = None,
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

    Where motions have own parameters ζᵢ, these are further numbers of zᵢ, with a normal prior.

    Derivatives are those of `MotionCost.squares`. Where numbers of the constraints are free, such as an unknown
    pivot, Φ depends on θ: its constants are the means over the observations for each θ.

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
        own: first guess and prior of the own parameters of each motion; None: they have none.
        followed: false for each motion that a fit has lost; None: none is. Initial states of such a motion are fitted
            as those of others, but not θ, and in the cost of the result it counts like the worst of the others.
        searches: steps of the initial states alone before the others.
        iterations: the most steps of initial states and θ together. It ends after three in a row that gain less than a
            thousandth of the cost each, and by their quadratic model could gain no more: from a good guess after 4.
        scale: s, image-plane units; errors above it count linearly.
        chunk: trajectories differentiated at a time.

    Returns:
        The dynamics with the fitted parameters, the initial states, the fitted paths, and their errors.

    Raises:
        KeycldError: for another kind of law, or motions with own parameters and shared constants.
    """
    law, (count, _, dim) = dynamics.law, observed.shape
    if not isinstance(law, ConstrainedLagrangian):
        raise KeycldError(f"motions are fitted through a ConstrainedLagrangian, not a {type(law).__name__}.")
    if own is not None and constants is not None:
        raise KeycldError("motions with own parameters have own constants of the constraints: give no shared ones.")
    precision = None if own is None else own.precision
    cost, theta = motion_cost(
        dynamics, free, observed, dt, frames, scale, shared=constants is not None, precision=precision
    )
    chosen = jnp.ones_like(theta) if active is None else ravel_pytree(eqx.filter(active, free))[0]
    if constants is None:
        constants = jax.vmap(lambda x: jnp.mean(jax.vmap(law.constraint)(x), axis=0))(observed)
    else:
        constants = jnp.broadcast_to(constants[None, :], (count, constants.shape[0]))
    start = rough_states(observed, dt) if initial is None else initial
    z = jnp.concatenate([start.x, cost.clock * start.v, *([] if own is None else [own.numbers])], axis=1)
    curvature = jnp.zeros((theta.size, theta.size))
    none = jnp.asarray(0)
    damping, least = jnp.asarray(1e-2), jnp.asarray(jnp.inf)
    motions = (observed, constants, u, *([] if own is None else [own.expected]))
    followed = jnp.ones(count, bool) if followed is None else followed
    begin = _Search(z, jnp.full(count, 1e-2), theta, damping, least, curvature, observed, none, none)

    # Parts of one size where that is possible: what is computed for each is compiled again for a smaller last one.
    alike = -(-count // -(-count // chunk))

    def unfinished(now: _Search) -> Array:
        return (now.stalls < _STALLS) & (now.taken < searches + iterations)

    def improve(now: _Search) -> _Search:
        return _improved(now, cost, chosen, now.taken < searches, motions, followed, alike)

    end = jax.lax.while_loop(unfinished, improve, begin)
    theta, off = end.theta, end.paths - observed
    first = jax.vmap(lambda z, x, held: cost.projected(z, theta, cost.constants(z, theta, x, held)))(
        end.z, observed, constants
    )
    squares = jax.vmap(lambda error: jnp.sum(cost.counted(error) ** 2))(off)
    errors = jnp.sqrt(squares / (jnp.sum(cost.counts) * dim))
    costs, fitted_own = jax.vmap(cost)(off), None
    if own is not None:
        costs, fitted_own = costs + jax.vmap(cost.unexpected)(end.z, own.expected), end.z[:, 2 * dim :]
    total = jnp.sum(jnp.where(followed, costs, jnp.max(costs, where=followed, initial=0.0)))
    initial = Motion(first[:, :dim], first[:, dim:])
    return Fitted(cost.dynamics(theta), initial, end.paths, errors, total, end.curvature, fitted_own, followed)


class _Search(NamedTuple):
    """What a step of the fit changes.

    Attributes:
        z: initial states.
        dampings: of each motion's initial state.
        theta: parameters.
        damping: of θ.
        least: the cost.
        curvature: as in `Fitted`.
        paths: of the motions.
        stalls: number of steps in a row that gained little.
        taken: number of steps.
    """

    z: Float[Array, "N S"]
    dampings: Float[Array, "N"]
    theta: Float[Array, "P"]
    damping: Float[Array, ""]
    least: Float[Array, ""]
    curvature: Float[Array, "P P"]
    paths: Float[Array, "N T dim"]
    stalls: Int[Array, ""]
    taken: Int[Array, ""]


def _improved(
    now: _Search,
    cost: MotionCost,
    chosen: Array,
    searching: Array,
    motions: tuple[Array, ...],
    followed: Array,
    chunk: int,
) -> _Search:
    """Take one step.

    Args:
        now: before it.
        cost: what is minimised.
        chosen: 1 for each number of θ that is fitted.
        searching: whether initial states alone move, and every step counts as a gain.
        motions: observations, constants and inputs of all motions, and what is expected of own parameters.
        followed: whether θ is fitted to each motion.
        chunk: motions at a time.
    """
    theta, size = now.theta, now.z.shape[1]

    def each(function: Callable[..., Any], *arrays: Array) -> Any:
        return jax.lax.map(lambda args: function(*args), arrays, batch_size=chunk)

    def eliminate(z: Array, damping: Array, *motion: Array) -> tuple[_Eliminated, Array, Array]:
        rows, left, value, path = cost.squares(z, theta, *motion)
        return _eliminated(rows, left, size, damping), value, path

    dampings = jnp.minimum(now.dampings, now.damping)
    motion, old, paths = each(eliminate, now.z, dampings, *motions)
    squares = jnp.sum(motion.squares, axis=0, where=followed[:, None, None])
    moves = jnp.where(searching, 0.0, chosen)
    curvature = squares[1:, 1:]
    damped = _damped(moves[:, None] * curvature * moves[None, :], now.damping)
    change = jnp.linalg.solve(damped, moves * squares[1:, 0])
    new_theta = theta - change
    new_z = now.z - jnp.einsum("nzt,t->nz", motion.steps, jnp.append(1.0, -change), precision="highest")

    def price(both: Array, x: Array, held: Array, push: Array, *expected: Array) -> tuple[Array, Array]:
        paths = jax.vmap(lambda z: cost.path(z, new_theta, cost.constants(z, new_theta, x, held), push).x)(both)
        prices = jax.vmap(lambda path: cost(path - x))(paths)
        for own in expected:
            prices = prices + jax.vmap(cost.unexpected, (0, None))(both, own)
        return prices, paths

    prices, new_paths = each(price, jnp.stack([now.z, new_z], axis=1), *motions)
    moved = prices[:, 1] < prices[:, 0]
    total, reached = jnp.sum(old, where=followed), jnp.sum(jnp.min(prices, axis=1), where=followed)
    better = reached < total
    slope = jnp.where(followed[:, None], motion.slope, 0.0)
    expected = 0.5 * (jnp.sum(slope[:, :size] * (now.z - new_z)) + jnp.sum(slope[:, size:] @ change))
    chosen_paths = jnp.where(moved[:, None, None], new_paths[:, 1], new_paths[:, 0])
    least = jnp.minimum(reached, total)
    # A step that gains nothing though much was expected went too far: the next one is shorter.
    going = (least < (1 - _GAIN) * now.least) | (~better & (expected > _GAIN * total)) | searching
    return _Search(
        z=jnp.where((better & moved)[:, None], new_z, now.z),
        dampings=_next_damping(moved, now.dampings),
        theta=jnp.where(better, new_theta, theta),
        damping=jnp.where(searching, now.damping, _next_damping(better, now.damping)),
        least=least,
        curvature=curvature,
        paths=jnp.where(better, chosen_paths, paths),
        stalls=jnp.where(going, 0, now.stalls + 1),
        taken=now.taken + 1,
    )


class _Eliminated(NamedTuple):
    """What ½ |A δ + b|² says of θ, without the initial state z of its motion. Column 0 stands for b, the others for θ.

    Attributes:
        steps: what must be taken from z, `[S, 1 + P]`: as it is, and for a change of each θ.
        squares: the squares of what is left, `[1 + P, 1 + P]`: value, slope and curvature.
        slope: Aᵀ b, `[Q]` with Q = S + P.
    """

    steps: Float[Array, "S columns"]
    squares: Float[Array, "columns columns"]
    slope: Float[Array, "Q"]


def _eliminated(rows: Float[Array, "R Q"], left: Float[Array, "R"], size: int, damping: Array) -> _Eliminated:
    """Eliminate the first `size` unknowns of ½ |A δ + b|², with damped steps."""

    def times(a: Array, b: Array) -> Array:
        return jnp.matmul(a, b, precision="highest")

    by_z, others = rows[:, :size], jnp.concatenate([left[:, None], rows[:, size:]], axis=1)
    inner = times(by_z.T, by_z)
    damped = _damped(inner, damping)
    steps = jnp.linalg.solve(damped, times(by_z.T, others))
    # Sums of squares: a difference of two such sums would be rounding where the motion is chaotic.
    rest, held = others - times(by_z, steps), jnp.sqrt(jnp.diagonal(damped - inner))[:, None] * steps
    return _Eliminated(steps, times(rest.T, rest) + times(held.T, held), times(rows.T, left))


def rough_states(observed: Float[Array, "N T dim"], dt: Scalar) -> Motion:
    """Return positions and velocities `[N, dim]` at frame 0 of a cubic through the first five frames."""
    window = min(5, observed.shape[1])
    powers = np.linalg.pinv(np.vander(np.arange(window), min(4, window), increasing=True))
    rows = jnp.asarray(powers[:2], observed.dtype)
    x, v = jnp.einsum("rt,ntd->rnd", rows, observed[:, :window], precision="highest")
    return Motion(x, v / dt)


def _damped(matrix: Array, damping: Array) -> Array:
    """Add the damped diagonal (Marquardt 1963); directions without curvature, such as a factor of M and V, get some."""
    diagonal = jnp.diagonal(matrix, axis1=-2, axis2=-1)
    largest = jnp.max(diagonal, axis=-1, keepdims=True, initial=0.0)
    diagonal = jnp.maximum(diagonal, _FLAT * largest) + 1e-12
    unit = jnp.eye(matrix.shape[-1]).reshape(*[1] * (matrix.ndim - 2), *matrix.shape[-2:])
    return matrix + (damping[..., None] * diagonal)[..., None] * unit


def _next_damping(better: Array, damping: Array) -> Array:
    return jnp.where(better, jnp.maximum(0.2 * damping, _LEAST), jnp.minimum(8 * damping, _MOST))
