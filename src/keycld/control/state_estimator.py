"""State estimators: positions and velocities from the keypoints observed so far."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from keycld._errors import KeycldError
from keycld.control.base import Belief
from keycld.mechanics import AbstractDynamics, ConstrainedLagrangian, Motion, State

_MEMORY = 50
"""Observations over which the constraints' constants are averaged."""


class AbstractStateEstimator(eqx.Module):
    """Estimates the motion of **one** copy of the system from its observed keypoints.

    Attributes:
        law: learned law of motion, for the constraints.
    """

    law: eqx.AbstractVar[ConstrainedLagrangian]

    @abc.abstractmethod
    def update(
        self, belief: Belief, observed: Float[Array, "dim"], arrived: Bool[Array, ""], u: Float[Array, "l"]
    ) -> Belief:
        """Return the belief at the next frame.

        Args:
            belief: at the last frame.
            observed: y [2K], keypoints in the new frame, image-plane units; not read where it did not arrive.
            arrived: whether there is a new frame.
            u: the input [l] held since the last frame.
        """

    def initial_belief(self) -> Belief:
        """Return the belief before the first frame: at the origin, which the first observation replaces."""
        dim = 2 * self.law.masses.shape[0]
        nothing = jnp.zeros(dim)
        state = State(Motion(nothing, nothing), {"constants": jnp.zeros(self.law.count)})
        return Belief(state, nothing, jnp.zeros((), jnp.int32))


class PredictCorrect(AbstractStateEstimator):
    """Predicts by the learned dynamics and corrects by what is observed: a Kalman filter in its steady state.

        x⁻, v⁻ = step(x, v, u) + (½ b dt², b dt),   e = y − x⁻,
        x = x⁻ + α e,   v = v⁻ + β e/dt,   b ← b + ρ β e/dt,

    then x is projected onto the constraints, and v and b onto ker DΦ. α and β are Kalata's gains (1984) for the ratio
    Γ = σₐ dt²/σ_y of what the model leaves open in a frame to the error of an observation. The first observations have
    larger gains, those of a least-squares line, so that two of them give position and velocity. A frame that did not
    arrive is predicted. If frames are missing between the first two observations, the second one divides by the whole
    time between them instead of dt.

    b is the acceleration that the learned dynamics lack; it is taken as constant for 1/ρ seconds. A learned gravity
    that is a tenth too weak hardly changes the prediction of the next frame, yet a controller that cancels it comes to
    rest off its goal. A controller that cancels b too does not.

    Attributes:
        law: learned law of motion, for the constraints.
        dynamics: the learned ones.
        dt: seconds between frames.
        acceleration_error: σₐ, image-plane units/s²: what the model does not know.
        observation_error: σ_y, image-plane units: of a keypoint in one frame.
        adaptation: ρ, 1/s; zero leaves b at zero.
        constants: Φ [n], where training has measured it; None: the mean of the last fifty observations. In poses that
            training hardly showed, observed lengths are wrong: the upright acrobot's lower link by 7 %.

    Good values: σₐ = 10, σ_y = 0.005 (a sixth of a pixel), and ρ = 6, a few times the √kp of the controller. Where
    plans are tracked, σₐ = 1 and ρ = 0.

    Raises:
        KeycldError: an error is not positive.
    """

    law: ConstrainedLagrangian
    dynamics: AbstractDynamics
    dt: float
    acceleration_error: float = 10.0
    observation_error: float = 0.005
    adaptation: float = 6.0
    constants: Float[Array, " n"] | None = None

    def __check_init__(self):
        """Check that both errors are positive."""
        if not (self.acceleration_error > 0 and self.observation_error > 0):
            raise KeycldError(
                f"a state estimator's errors are positive, not {self.acceleration_error} and {self.observation_error}."
            )

    @property
    def gains(self) -> tuple[float, float]:
        """The steady α and β."""
        ratio = self.acceleration_error * self.dt**2 / self.observation_error
        r = (4 + ratio - np.sqrt(8 * ratio + ratio**2)) / 4
        alpha = 1 - r**2
        return float(alpha), float(2 * (2 - alpha) - 4 * r)

    def update(
        self, belief: Belief, observed: Float[Array, "dim"], arrived: Bool[Array, ""], u: Float[Array, "l"]
    ) -> Belief:
        """Predict the motion, then correct it."""
        n = belief.observations
        first, missing = n == 0, ~arrived
        # The first observation is the initial position.
        before = State(
            Motion(jnp.where(first, observed, belief.state.coordinates.x), belief.state.coordinates.v),
            {"constants": jnp.where(first, self._lengths(observed), belief.state.parameters["constants"])},
        )
        ahead = self.dynamics.step(before, u, self.dt).coordinates
        drift = self.law.project_velocity(ahead.x, belief.unmodelled)
        x0 = jnp.where(first, observed, ahead.x + 0.5 * self.dt**2 * drift)
        miss = jnp.where(missing | first, 0.0, observed - x0)

        count = n.astype(observed.dtype)
        early = (count + 1) * (count + 2)
        steady_alpha, steady_beta = self.gains
        alpha = jnp.maximum(steady_alpha, 2 * (2 * count + 1) / early)
        beta = jnp.maximum(steady_beta, 6 / early)
        old = before.parameters["constants"]
        share = jnp.where(missing, 0.0, 1 / jnp.minimum(count + 1, _MEMORY))
        constants = old + share * (self._lengths(jnp.where(missing, x0, observed)) - old)
        x = self.law.project_position(x0 + alpha * miss, constants)
        # Until the second observation nothing is known of the velocity: its miss is that of all frames since the first.
        seconds = self.dt * jnp.where(n == 1, belief.missed + 1, 1)
        v = jnp.where(first, 0.0, ahead.v + self.dt * drift + beta * miss / seconds)
        state = State(Motion(x, self.law.project_velocity(x, v)), {"constants": constants})
        # While the velocity itself is uncertain, a miss tells nothing about forces.
        settled = jnp.where(steady_beta >= 6 / early, 1.0, 0.0)
        unmodelled = drift + settled * self.adaptation * steady_beta * miss / self.dt
        unmodelled = self.law.project_velocity(x, unmodelled)
        missed = jnp.where(missing, belief.missed + 1, 0)
        return _choose(first & missing, belief, Belief(state, unmodelled, n + arrived.astype(n.dtype), missed))

    def _lengths(self, x: Array) -> Array:
        return self.law.constraint(x) if self.constants is None else self.constants


class BackwardDifference(AbstractStateEstimator):
    """Takes x = y and v = (y − y₋)/dt, projected onto ker DΦ; for comparison.

    The velocity is half a frame late and has noise of deviation σ_y √2/dt. A frame that did not arrive leaves position
    and velocity as they were; after m of them the next difference is divided by (m + 1) dt.

    Attributes:
        law: learned law of motion, for the constraints.
        dt: seconds between frames.
    """

    law: ConstrainedLagrangian
    dt: float

    def update(
        self, belief: Belief, observed: Float[Array, "dim"], arrived: Bool[Array, ""], u: Float[Array, "l"]
    ) -> Belief:
        """Return the new position and its difference from the last one."""
        n = belief.observations
        x, v = belief.state.coordinates
        seconds = self.dt * (belief.missed + 1)
        v = self.law.project_velocity(observed, jnp.where(n == 0, 0.0, (observed - x) / seconds))
        state = State(Motion(observed, v), {"constants": self.law.constraint(observed)})
        stay = Belief(belief.state, belief.unmodelled, n, belief.missed + 1)
        return _choose(~arrived, stay, Belief(state, jnp.zeros_like(observed), n + 1))


def _choose(old_stays: Array, old: Belief, new: Belief) -> Belief:
    return jax.tree.map(lambda a, b: jnp.where(old_stays, a, b), old, new)
