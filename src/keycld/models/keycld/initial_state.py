"""The initial state of a motion, from the keypoints of the given frames."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld._errors import KeycldError
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


class AbstractInitialState(eqx.Module):
    """Keypoints of consecutive frames → state."""

    @property
    @abstractmethod
    def given(self) -> int:
        """How many frames it takes."""

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
        """Return the state at frame `anchor`; `u` is constant `[l]`, or `[≥ given − 1, l]` from the first frame on."""


class FittedInitialState(AbstractInitialState):
    """The state at frame 0 of the motion that passes through the given frames, found through the dynamics.

    The observed keypoints are first brought to common values of the constraints, so that a motion can keep them. Two
    frames decide the velocity with which one step of the dynamics joins them; a plain difference would be wrong by the
    curvature of the path within a frame. With more frames, Gauss–Newton steps from there minimise Σ |x(t) − x̂(t)|²
    over the observed x̂, which averages the observation errors.

    Attributes:
        constants: values of Φ that all trajectories share, as the lengths of one machine are, measured on the training
            keypoints and not trained. None: each trajectory has its own, the mean over its given frames. A length that
            is 1 % off in two frames makes forces 1 % wrong: on the pendulum sharing is worth .70 → .84 in valid
            prediction time at 200 frames.
        given: 2 or more.
        iterations: Gauss–Newton steps for more than two frames. Over a few frames a motion is so nearly linear in its
            initial state that two are enough.
    """

    constants: Float[Array, " n"] | None
    given: int = eqx.field(static=True, default=2)
    iterations: int = eqx.field(static=True, default=2)

    @property
    def anchor(self) -> int:
        """The first frame."""
        return 0

    @property
    def shared(self) -> Float[Array, " n"] | None:
        """The constants."""
        return self.constants

    def __check_init__(self):
        """Refuse one frame, which tells no velocity."""
        if self.given < 2:
            raise KeycldError(f"a motion starts from 2 or more given frames, not {self.given}.")

    def __call__(
        self, dynamics: AbstractDynamics, x: Float[Array, "given dim"], dt: Float[Array, ""], u: Float[Array, "..."]
    ) -> State:
        """Return the state at frame 0."""
        assert isinstance(dynamics, MechanicalDynamics) and isinstance(dynamics.law, ConstrainedLagrangian)
        law, dim = dynamics.law, x.shape[1]
        constants = self.constants
        if constants is None:
            constants = jnp.mean(jax.vmap(law.constraint)(x), axis=0)
        parameters = {"constants": constants}
        x0, x1 = law.project_position(x[0], constants), law.project_position(x[1], constants)
        v0 = joining_velocity(dynamics, x0, x1, parameters, u if u.ndim == 1 else u[0], dt)
        if self.given == 2:
            return State(Motion(x0, v0), parameters)

        def state(z: Array) -> State:
            position = law.project_position(z[:dim], constants)
            return State(Motion(position, law.project_velocity(position, z[dim:] / dt)), parameters)

        def miss(z: Array) -> Array:
            inputs = u if u.ndim == 1 else u[: self.given - 1]
            return (dynamics.rollout(state(z), inputs, dt, self.given - 1).x - x).reshape(-1)

        z = jnp.concatenate([x0, dt * v0])
        for _ in range(self.iterations):
            # The directions that the projections remove have no effect; the solver's damping leaves them alone.
            jacobian = jax.jacfwd(miss)(z)
            normal = jnp.matmul(jacobian.T, jacobian, precision="highest") + 1e-4 * jnp.eye(2 * dim)
            z = z - solve_positive(normal, jnp.matmul(jacobian.T, miss(z), precision="highest"))
        return state(z)


class DifferenceInitialState(AbstractInitialState):
    """The second frame's keypoints and the difference of the two over dt (arXiv v1, section 4)."""

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
    """The second of three frames, with the central difference projected on ker DΦ (2024 version)."""

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
    """Return what stays constant along a motion through x: the constraints' values, where the law has constraints."""
    law = _lagrangian(dynamics)
    return {} if law is None else {"constants": law.constraint(x)}


def allowed_velocity(dynamics: AbstractDynamics, x: Float[Array, "dim"], v: Float[Array, "dim"]) -> Float[Array, "dim"]:
    """Return the nearest velocity with DΦ(x) v = 0 in the plain metric, as the released code projects it."""
    law = _lagrangian(dynamics)
    if law is None or law.count == 0:
        return v
    jacobian = law.jacobian(x)
    normal = jnp.matmul(jacobian, jacobian.T, precision="highest")
    push = solve_positive(normal, jnp.matmul(jacobian, v, precision="highest"))
    return v - jnp.matmul(jacobian.T, push, precision="highest")


def _lagrangian(dynamics: AbstractDynamics) -> ConstrainedLagrangian | None:
    if isinstance(dynamics, AbstractMechanicalDynamics) and isinstance(dynamics.law, ConstrainedLagrangian):
        return dynamics.law
    return None
