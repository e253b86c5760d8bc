"""Estimation of the initial state from the keypoints of the given frames."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.mechanics import (
    AbstractDynamics,
    AbstractMechanicalDynamics,
    ConstrainedLagrangian,
    MechanicalDynamics,
    Motion,
    State,
    joining_velocity,
    solve_positive,
)

# ν of Student's t: the tails of observation errors.
TAIL = 4


class AbstractInitialState(eqx.Module):
    """Keypoints of consecutive frames → state."""

    @property
    @abstractmethod
    def given(self) -> int:
        """The number of given frames that it needs."""

    @property
    @abstractmethod
    def anchor(self) -> int:
        """The frame that the state belongs to."""

    @property
    @abstractmethod
    def shared(self) -> Float[Array, " n"] | None:
        """Values of Φ that all trajectories share; None where each has its own."""

    @abstractmethod
    def __call__(
        self, dynamics: AbstractDynamics, x: Float[Array, "given dim"], dt: Float[Array, ""], u: Float[Array, "..."]
    ) -> State:
        """Return the state at frame `anchor`.

        Args:
            dynamics: the law of motion and its integrator.
            x: keypoints of the given frames, image-plane units.
            dt: seconds between frames.
            u: constant `[l]`, or `[≥ given − 1, l]` from the first frame on.
        """

    def smooth(
        self,
        dynamics: AbstractDynamics,
        x: Float[Array, "n dim"],
        dt: Float[Array, ""],
        u: Float[Array, "..."],
        light: Float[Array, "K 4"] | None = None,
    ) -> tuple[State, Float[Array, "size size"] | None]:
        """Return the state at frame `anchor` from n ≥ `given` frames, and the covariance of its (x, v) if it is known.

        By default only the first `given` frames are used. The light of the parts tells own parameters.
        """
        return self(dynamics, x[: self.given], dt, u), None


def reweighted(
    off: Float[Array, "n K 2"], slopes: Float[Array, "n K 2 size"]
) -> tuple[Float[Array, "size size"], Float[Array, "size"]]:
    """Return the normal equations of errors with the tails of Student's t: matrix and slope.

        ρ(e) = (ν + 2)/2 log(1 + e²/ν),    weights (ν + 2) / (ν + e²),    ν = 4

    Args:
        off: errors e of keypoints, in their deviations.
        slopes: their derivatives.
    """
    weight = (TAIL + 2) / (TAIL + jnp.sum(off**2, axis=2, keepdims=True))
    flat = slopes.reshape(off.size, -1)
    pull = flat * jnp.broadcast_to(weight, off.shape).reshape(-1, 1)
    normal = jnp.matmul(pull.T, flat, precision="highest")
    return normal, jnp.matmul(pull.T, off.reshape(-1), precision="highest")


class FittedInitialState(AbstractInitialState):
    """The state at frame 0, fitted through the dynamics to the keypoints of the given frames.

    The observed keypoints x̂_t are first projected on Φ(x) = constants, so that a motion can keep them. With two frames
    the velocity v₀ is the one with which one step of the dynamics leads from x_0 to x_1; the difference (x_1 − x_0)/dt
    would be wrong by the curvature of the path within a frame. With more frames, Gauss–Newton iterations from there
    minimise

        Σ_tk ρ(|x_k(t; x_0, v_0) − x̂_tk| / σ_k),    ρ(e) = (ν + 2)/2 log(1 + e²/ν),    ν = 4

    the negative logarithm of Student's t: an observation far from the motion gets a larger covariance of its own. All
    given frames count, so each averages the errors of the others. Ours; the papers use differences of two or three
    frames.

    Attributes:
        constants: `[n]`, values of Φ that all trajectories share, such as the lengths of one machine. They are measured
            on the training keypoints, not trained. None: each trajectory has its own, the mean over its given frames.
            An error of 1 % in a length makes forces 1 % wrong: on the pendulum, shared constants raise the valid
            prediction time at 200 frames from .70 to .84.
        error: σ [K] of the two coordinates of each observed keypoint, image-plane units; measured, not trained.
        iterations: Gauss–Newton iterations for more than two frames.
    """

    constants: Float[Array, " n"] | None
    error: Float[Array, " K"]
    iterations: int = eqx.field(static=True, default=5)

    @property
    def given(self) -> int:
        """Two: fewer frames have no velocity."""
        return 2

    @property
    def anchor(self) -> int:
        """The first frame."""
        return 0

    @property
    def shared(self) -> Float[Array, " n"] | None:
        """The constants."""
        return self.constants

    def __call__(
        self, dynamics: AbstractDynamics, x: Float[Array, "given dim"], dt: Float[Array, ""], u: Float[Array, "..."]
    ) -> State:
        """Return the state at frame 0 from two frames."""
        law = _lagrangian(dynamics)
        assert isinstance(dynamics, MechanicalDynamics) and law is not None
        constants = self.constants
        if constants is None:
            constants = jnp.mean(jax.vmap(law.constraint)(x), axis=0)
        parameters = {"constants": constants}
        x0, x1 = law.project_position(x[0], constants), law.project_position(x[1], constants)
        v0 = joining_velocity(dynamics, x0, x1, parameters, u if u.ndim == 1 else u[0], dt)
        return State(Motion(x0, v0), parameters)

    def smooth(
        self,
        dynamics: AbstractDynamics,
        x: Float[Array, "n dim"],
        dt: Float[Array, ""],
        u: Float[Array, "..."],
        light: Float[Array, "K 4"] | None = None,
    ) -> tuple[State, Float[Array, "size size"] | None]:
        """Return the state at frame 0 from all frames; the covariance is None for two frames."""
        law, (count, dim) = _lagrangian(dynamics), x.shape
        assert isinstance(dynamics, MechanicalDynamics) and law is not None
        first = self(dynamics, x[:2], dt, u)
        if count == 2:
            return first, None
        constants = self.constants
        if constants is None:
            constants = jnp.mean(jax.vmap(law.constraint)(x), axis=0)
        clock, parameters = dt * (count - 1) / 2, {"constants": constants}

        def state(z: Array) -> State:
            position = law.project_position(z[:dim], constants)
            return State(Motion(position, law.project_velocity(position, z[dim:] / clock)), parameters)

        def residual(z: Array) -> Array:
            inputs = u if u.ndim == 1 else u[: count - 1]
            off = (dynamics.rollout(state(z), inputs, dt, count - 1).x - x).reshape(count, -1, 2)
            return off / self.error[None, :, None]

        def weighted(z: Array) -> tuple[Array, Array]:
            return reweighted(residual(z), jax.jacfwd(residual)(z))

        def improve(z: Array, _: None) -> tuple[Array, None]:
            normal, slope = weighted(z)
            # The projections remove some directions of z; the damping keeps the matrix regular there.
            damping = 1e-5 * jnp.trace(normal) * jnp.eye(2 * dim)
            return z - jnp.linalg.solve(normal + damping, slope), None

        z = jnp.concatenate([first.coordinates.x, clock * first.coordinates.v])
        z, _ = jax.lax.scan(improve, z, length=self.iterations)
        unit = jnp.repeat(jnp.array([1.0, 1 / clock]), dim)
        covariance = jnp.linalg.pinv(weighted(z)[0], rtol=1e-5, hermitian=True) * unit[:, None] * unit[None, :]
        return state(z), covariance


class DifferenceInitialState(AbstractInitialState):
    """The state at the second of two frames: v₁ = (x₁ − x₀)/dt (arXiv v1, section 4)."""

    @property
    def given(self) -> int:
        """Two."""
        return 2

    @property
    def anchor(self) -> int:
        """The second frame."""
        return 1

    @property
    def shared(self) -> None:
        """None: each trajectory keeps the values of its own frames."""

    def __call__(
        self, dynamics: AbstractDynamics, x: Float[Array, "given dim"], dt: Float[Array, ""], u: Float[Array, "..."]
    ) -> State:
        """Return the state at frame 1."""
        return State(Motion(x[1], (x[1] - x[0]) / dt), held(dynamics, x[1]))


class CentralInitialState(AbstractInitialState):
    """The state at the second of three frames: v₁ = (x₂ − x₀)/(2 dt), projected on ker DΦ(x₁) (2024 version)."""

    @property
    def given(self) -> int:
        """Three."""
        return 3

    @property
    def anchor(self) -> int:
        """The second frame."""
        return 1

    @property
    def shared(self) -> None:
        """None: each trajectory keeps the values of its own frames."""

    def __call__(
        self, dynamics: AbstractDynamics, x: Float[Array, "given dim"], dt: Float[Array, ""], u: Float[Array, "..."]
    ) -> State:
        """Return the state at frame 1."""
        v = (x[2] - x[0]) / (2 * dt)
        return State(Motion(x[1], allowed_velocity(dynamics, x[1], v)), held(dynamics, x[1]))


def held(dynamics: AbstractDynamics, x: Float[Array, "dim"]) -> dict[str, Array]:
    """Return what stays constant along a motion through x: the values of Φ, if the law has constraints."""
    law = _lagrangian(dynamics)
    return {} if law is None else {"constants": law.constraint(x)}


def allowed_velocity(dynamics: AbstractDynamics, x: Float[Array, "dim"], v: Float[Array, "dim"]) -> Float[Array, "dim"]:
    """Return the nearest velocity with DΦ(x) v = 0 in the Euclidean metric, as in the released code.

        v − DΦᵀ (DΦ DΦᵀ)⁻¹ DΦ v

    Args:
        dynamics: a law without constraints returns `v` itself.
        x: positions, image-plane units.
        v: velocities, image-plane units a second.
    """
    law = _lagrangian(dynamics)
    if law is None or law.count == 0:
        return v
    jacobian = law.jacobian(x)
    normal = jnp.matmul(jacobian, jacobian.T, precision="highest")
    multipliers = solve_positive(normal, jnp.matmul(jacobian, v, precision="highest"))
    return v - jnp.matmul(jacobian.T, multipliers, precision="highest")


def _lagrangian(dynamics: AbstractDynamics) -> ConstrainedLagrangian | None:
    if isinstance(dynamics, AbstractMechanicalDynamics) and isinstance(dynamics.law, ConstrainedLagrangian):
        return dynamics.law
    return None
