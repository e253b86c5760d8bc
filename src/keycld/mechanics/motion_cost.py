"""The cost of one motion beside its observations, and its derivatives by the initial state and the law's parameters."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PyTree

from keycld.mechanics.dynamics import MechanicalDynamics
from keycld.mechanics.lagrangian import ConstrainedLagrangian
from keycld.mechanics.own_parameters import own_law, own_parameters
from keycld.mechanics.state import Motion, Scalar, State


@dataclasses.dataclass(frozen=True)
class MotionCost:
    """The robust distance of paths from observations, as a function of initial states z and parameters θ.

        c(z, θ) = Σₜₖ ρ(xₖ(t; z, θ) − observedₜₖ),    ρ(e) = s²(√(1 + (e/s)²) − 1)

    z = (x₀, v₀ · clock) need not keep the constraints: it is projected on them. With clock, half of the time of a
    motion, velocities weigh like positions. Where motions have own parameters ζ (`own_parameters`), z ends with them,
    and c has the further term ½ (ζ − ζ̄)ᵀ Λ (ζ − ζ̄).

    Attributes:
        unravel: gives the free leaves of the dynamics from θ.
        rest: the other leaves.
        geometry: which entries of θ are numbers of the constraints, such as an unknown pivot.
        among: where θ has such numbers and all motions share the constants of Φ: the observations `[M, dim]` whose
            means the constants are. None: each motion has the means over its own observations.
        counts: 1 for each frame that counts, 0 for the others.
        dt: seconds between frames.
        scale: s, image-plane units; errors above it count linearly.
        dim: coordinates of a position.
        precision: Λ [S, S]; None: there are no own parameters.
    """

    unravel: Callable[[Array], PyTree]
    rest: PyTree
    geometry: np.ndarray
    among: Float[Array, "M dim"] | None
    counts: Float[Array, "T"]
    dt: Scalar
    scale: float
    dim: int
    precision: Float[Array, "S S"] | None = None

    @property
    def clock(self) -> Scalar:
        """Seconds by which velocities are multiplied."""
        return len(self.counts) * self.dt / 2

    def dynamics(self, theta: Array) -> MechanicalDynamics:
        """Return the dynamics with the parameters θ."""
        return eqx.combine(self.unravel(theta), self.rest)

    def own(self, z: Array) -> dict[str, Array]:
        """Return the own parameters in z as entries of a state's parameters; none where motions have none."""
        return {} if self.precision is None else own_parameters(z[2 * self.dim :])

    def unexpected(self, z: Array, expected: Array) -> Float[Array, ""]:
        """Return ½ (ζ − ζ̄)ᵀ Λ (ζ − ζ̄)."""
        assert self.precision is not None
        off = z[2 * self.dim :] - expected
        return 0.5 * jnp.sum(off * jnp.matmul(self.precision, off, precision="highest"))

    def constants(self, z: Array, theta: Array, x: Array, given: Array) -> Array:
        """Return the constants of a motion with the observations x: the given ones unless Φ depends on θ or ζ."""
        if not self.geometry.size and self.precision is None:
            return given
        among = x if self.among is None else self.among
        return jnp.mean(jax.vmap(own_law(self._law(theta), self.own(z)).constraint)(among), axis=0)

    def projected(self, z: Array, theta: Array, constants: Array) -> Array:
        """Return the state (x₀, v₀) on the constraints."""
        law = own_law(self._law(theta), self.own(z))
        x = law.project_position(z[: self.dim], constants)
        return jnp.concatenate([x, law.project_velocity(x, z[self.dim : 2 * self.dim] / self.clock)])

    def path(self, z: Array, theta: Array, constants: Array, u: Array) -> Motion:
        """Return the motion from z."""
        first, steps = self.projected(z, theta, constants), len(self.counts) - 1
        state = State(Motion(first[: self.dim], first[self.dim :]), {"constants": constants, **self.own(z)})
        return self.dynamics(theta).rollout(state, u if u.ndim == 1 else u[:steps], self.dt, steps)

    def counted(self, values: Array) -> Array:
        """Return values of all frames with zeros in the frames that do not count."""
        # What has diverged after the last frame that counts must not spread.
        return jnp.where(self.counts.reshape(-1, *[1] * (values.ndim - 1)) > 0, values, 0.0)

    def __call__(self, error: Float[Array, "T dim"]) -> Float[Array, ""]:
        """Return the cost of these differences; infinity if one is not finite."""
        # s² (√(1 + (e/s)²) − 1), in a form that small errors do not cancel in.
        squares = self.counted(error) ** 2
        total = jnp.sum(squares / (1 + jnp.sqrt(1 + squares / self.scale**2)))
        return jnp.where(jnp.isfinite(total), total, jnp.inf)

    def squares(
        self, z: Array, theta: Array, x: Array, given: Array, u: Array, expected: Array | None = None
    ) -> tuple[Float[Array, "R S"], Float[Array, "R"], Float[Array, ""], Float[Array, "T dim"]]:
        """Compute A and b of the model ½ |A δ + b|² of the cost at (z, θ) + δ, its value, and the path.

        Rows, not AᵀA: the motion of a double pendulum depends on z so strongly that what θ changes of it next to z is
        lost in the rounding of sums of squares.

        Derivatives come from the transition matrix A of each frame, ∂(x, v)ₜ₊₁ = Aₜ ∂(x, v)ₜ + Bₜ ∂θ. A is exact. B
        takes the derivative of the acceleration at the two frames as linear between them: an error of (ω dt)², which
        slows the convergence a little and leaves the paths exact, for a fifth of the time. For numbers of the
        constraints and own parameters B is exact.

        Args:
            z: initial state.
            theta: θ.
            x: observations of the motion `[T, dim]`.
            given: constants of Φ, used where Φ does not depend on θ.
            u: inputs, constant `[l]` or one a frame `[T, l]`.
            expected: ζ̄, where motions have own parameters.
        """
        length, dim, size, moving = len(self.counts), self.dim, len(z), 2 * self.dim
        constants = self.constants(z, theta, x, given)
        path = self.path(z, theta, constants, u)
        states, error = jnp.concatenate([path.x, path.v], axis=1), path.x - x
        inputs = jnp.broadcast_to(u[None], (length, u.shape[0])) if u.ndim == 1 else u

        # Numbers of the constraints and own parameters are differentiated together with the state, for half of the
        # program. They change the constants too, by their slopes alone, or each frame would compute these anew.
        free = len(self.geometry)
        rest = jnp.concatenate([theta[self.geometry], z[moving:]])

        def changed(rest: Array) -> tuple[Array, Array]:
            """Return z and θ with these own parameters and numbers of the constraints."""
            other = theta.at[self.geometry].set(rest[:free]) if free else theta
            return jnp.concatenate([z[:moving], rest[free:]]), other

        by_rest = jax.jacfwd(lambda rest: self.constants(*changed(rest), x, given))(rest)

        def held(now: Array) -> Array:
            return constants + jnp.matmul(by_rest, now - rest, precision="highest") if rest.size else constants

        def step(both: Array, u: Array) -> Array:
            state, now = both[:moving], both[moving:]
            own, other = changed(now)
            begin = State(Motion(state[:dim], state[dim:]), {"constants": held(now), **self.own(own)})
            return jnp.concatenate(self.dynamics(other).step(begin, u, self.dt).coordinates)

        def project(both: Array) -> Array:
            own, other = changed(both[moving:])
            return self.projected(own.at[:moving].set(both[:moving]), other, held(both[moving:]))

        def accelerate(theta: Array, state: Array, u: Array) -> Array:
            return own_law(self.dynamics(theta).law, self.own(z)).acceleration(state[:dim], state[dim:], u)

        def placed(by: Array, everything: Array) -> Array:
            """Return derivatives by (z, θ) with these of the numbers in `rest`."""
            everything = everything.at[..., size + self.geometry].set(by[..., :free])
            return everything.at[..., moving:size].set(by[..., free:])

        slope = jax.vmap(lambda state, u: jax.jacfwd(step)(jnp.concatenate([state, rest]), u))(states[:-1], inputs[:-1])
        transitions, stepped = slope[..., :moving], slope[..., moving:]
        slope = jax.jacfwd(project)(jnp.concatenate([z[:moving], rest]))
        first = jnp.pad(slope[:, :moving], ((0, 0), (0, size - moving + theta.size)))
        first = placed(slope[:, moving:], first)
        here = then = jnp.zeros((length - 1, dim, 0))
        if theta.size:
            by_theta = jax.vmap(lambda state, u: jax.jacrev(accelerate)(theta, state, u))
            slopes = by_theta(states, inputs)
            # A frame ends with the input that it began with.
            here, then = slopes[:-1], slopes[1:] if u.ndim == 1 else by_theta(states[1:], inputs[:-1])
        pushes = jnp.concatenate([self.dt**2 / 6 * (2 * here + then), self.dt / 2 * (here + then)], axis=1)
        pushes = placed(stepped, jnp.concatenate([jnp.zeros((length - 1, moving, size)), pushes], axis=2))

        def pass_frame(slope: Array, matrices: tuple[Array, Array]) -> tuple[Array, Array]:
            slope = jnp.matmul(matrices[0], slope, precision="highest") + matrices[1]
            return slope, slope[:dim]

        _, later = jax.lax.scan(pass_frame, first, (transitions, pushes))
        slopes = self.counted(jnp.concatenate([first[None, :dim], later])).reshape(length * dim, -1)
        error = self.counted(error)
        weight = (1 + (error / self.scale) ** 2).reshape(-1) ** -0.25
        rows, left, value = weight[:, None] * slopes, weight * error.reshape(-1), self(error)
        if self.precision is not None:
            assert expected is not None
            values, vectors = jnp.linalg.eigh(self.precision)
            root = jnp.sqrt(jnp.maximum(values, 0.0))[:, None] * vectors.T
            own = jnp.zeros((len(root), rows.shape[1])).at[:, moving:size].set(root)
            rows = jnp.concatenate([rows, own])
            left = jnp.concatenate([left, jnp.matmul(root, z[moving:] - expected, precision="highest")])
            value = value + self.unexpected(z, expected)
        # A motion whose derivatives overflow keeps its state, and θ does not hear of it.
        sound = jnp.isfinite(jnp.sum(rows**2)) & jnp.isfinite(jnp.sum(left**2))
        return jnp.where(sound, rows, 0.0), jnp.where(sound, left, 0.0), value, path.x

    def _law(self, theta: Array) -> ConstrainedLagrangian:
        law = self.dynamics(theta).law
        assert isinstance(law, ConstrainedLagrangian)
        return law


def motion_cost(
    dynamics: MechanicalDynamics,
    free: PyTree,
    observed: Float[Array, "N T dim"],
    dt: Scalar,
    frames: int | Int[Array, ""] | None,
    scale: float,
    *,
    shared: bool,
    precision: Float[Array, "S S"] | None = None,
) -> tuple[MotionCost, Float[Array, "P"]]:
    """Return the cost of motions, and θ of the given dynamics.

    Args:
        dynamics: of a `ConstrainedLagrangian`.
        free: a pytree of bools of the dynamics' shape: which leaves are θ.
        observed: observed positions.
        dt: seconds between frames.
        frames: how many of the first frames count; None: all.
        scale: s of the cost.
        shared: whether all motions have the same constants of Φ.
        precision: Λ of their own parameters; None: they have none.
    """
    _, length, dim = observed.shape
    parameters, rest = eqx.partition(dynamics, free)
    theta, unravel = ravel_pytree(parameters)
    of_constraints = [
        np.full(leaf.size, ".constraint_function" in jax.tree_util.keystr(path))
        for path, leaf in jax.tree_util.tree_leaves_with_path(parameters)
    ]
    geometry = np.flatnonzero(np.concatenate([np.zeros(0, bool), *of_constraints]))
    counts = (jnp.arange(length) < (length if frames is None else frames)).astype(observed.dtype)
    among = observed.reshape(-1, dim) if shared else None
    return MotionCost(unravel, rest, geometry, among, counts, dt, scale, dim, precision), theta
