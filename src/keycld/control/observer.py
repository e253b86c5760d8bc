"""Position and velocity from the frames seen so far."""

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
"""Sightings over which the constraints' constants are averaged."""


class AbstractObserver(eqx.Module):
    """Turns sightings into motion."""

    law: eqx.AbstractVar[ConstrainedLagrangian]

    @abc.abstractmethod
    def update(
        self, belief: Belief, seen: Float[Array, "dim"], arrived: Bool[Array, ""], u: Float[Array, "l"]
    ) -> Belief:
        """The belief at the next frame.

        Args:
            belief: at the last frame.
            seen: keypoints in the new frame; not read where it did not arrive.
            arrived: whether there is a new frame.
            u: the input held since the last frame.
        """

    def begin(self) -> Belief:
        """Nothing seen yet: at the origin, which the first sighting replaces."""
        dim = 2 * self.law.masses.shape[0]
        nothing = jnp.zeros(dim)
        state = State(Motion(nothing, nothing), {"constants": jnp.zeros(self.law.count)})
        return Belief(state, nothing, jnp.zeros((), jnp.int32))


class PredictCorrect(AbstractObserver):
    """Predicts by the learned dynamics and corrects by what is seen: a Kalman filter in its steady state.

        x⁻, v⁻ = step(x, v, u) + (½ b dt², b dt),   x = x⁻ + α e,   v = v⁻ + β e/dt,   b ← b + ρ β e/dt,   e = y − x⁻,

    then x onto the constraints and v onto ker DΦ. α and β are Kalata's gains (1984) for Γ = σₐ dt²/σ_y, the ratio of
    what the model leaves open in a frame to the error of a sighting; the first sightings count for more, as in a
    least-squares line, so that two of them give position and velocity. A frame that did not arrive is predicted.

    b is the acceleration that the learned dynamics lack, held to be constant for 1/ρ seconds. A law of motion whose
    gravity is a tenth too weak predicts every picture of a next frame well, yet a controller that cancels gravity by it
    would come to rest beside its goal; one that cancels b too does not.

    Attributes:
        law: for the constraints.
        dynamics: the learned ones.
        dt: seconds between frames.
        acceleration_error: σₐ, image-plane units/s²: what the model does not know.
        sighting_error: σ_y, image-plane units: of a keypoint in one frame.
        adaptation: ρ, 1/s; zero leaves b at zero.
        constants: of the constraints, where training has measured them; None: the mean of the last fifty sightings.
            A pose that training hardly showed is seen with wrong lengths: the upright acrobot's lower link by 7 %.

    Good values: σₐ = 10, σ_y = 0.005 (a sixth of a pixel), ρ = 6, some times the √kp of the controller. Where plans are
    followed σₐ = 1, ρ = 0: on the acrobot's swings its slow unstable direction is then known to 0.9°, not 1.7°.
    """

    law: ConstrainedLagrangian
    dynamics: AbstractDynamics
    dt: float
    acceleration_error: float = 10.0
    sighting_error: float = 0.005
    adaptation: float = 6.0
    constants: Float[Array, " n"] | None = None

    def __check_init__(self):
        """Errors are positive."""
        if not (self.acceleration_error > 0 and self.sighting_error > 0):
            raise KeycldError(
                f"an observer's errors are positive, not {self.acceleration_error} and {self.sighting_error}."
            )

    @property
    def gains(self) -> tuple[float, float]:
        """The steady α and β."""
        ratio = self.acceleration_error * self.dt**2 / self.sighting_error
        r = (4 + ratio - np.sqrt(8 * ratio + ratio**2)) / 4
        alpha = 1 - r**2
        return float(alpha), float(2 * (2 - alpha) - 4 * r)

    def update(
        self, belief: Belief, seen: Float[Array, "dim"], arrived: Bool[Array, ""], u: Float[Array, "l"]
    ) -> Belief:
        """Predict, then correct."""
        n = belief.sightings
        first, missing = n == 0, ~arrived
        # The first sighting is where the motion begins.
        begin = State(
            Motion(jnp.where(first, seen, belief.state.coordinates.x), belief.state.coordinates.v),
            {"constants": jnp.where(first, self._lengths(seen), belief.state.parameters["constants"])},
        )
        ahead = self.dynamics.step(begin, u, self.dt).coordinates
        drift = self.law.project_velocity(ahead.x, belief.unmodelled)
        x0 = jnp.where(first, seen, ahead.x + 0.5 * self.dt**2 * drift)
        miss = jnp.where(missing | first, 0.0, seen - x0)

        count = n.astype(seen.dtype)
        early = (count + 1) * (count + 2)
        steady_alpha, steady_beta = self.gains
        alpha = jnp.maximum(steady_alpha, 2 * (2 * count + 1) / early)
        beta = jnp.maximum(steady_beta, 6 / early)
        old = begin.parameters["constants"]
        share = jnp.where(missing, 0.0, 1 / jnp.minimum(count + 1, _MEMORY))
        constants = old + share * (self._lengths(jnp.where(missing, x0, seen)) - old)
        x = self.law.project_position(x0 + alpha * miss, constants)
        v = jnp.where(first, 0.0, ahead.v + self.dt * drift + beta * miss / self.dt)
        state = State(Motion(x, self.law.project_velocity(x, v)), {"constants": constants})
        # While the velocity itself is still being found, a miss says nothing of forces.
        settled = jnp.where(steady_beta >= 6 / early, 1.0, 0.0)
        unmodelled = drift + settled * self.adaptation * steady_beta * miss / self.dt
        unmodelled = self.law.project_velocity(x, unmodelled)
        return _choose(first & missing, belief, Belief(state, unmodelled, n + arrived.astype(n.dtype)))

    def _lengths(self, x: Array) -> Array:
        return self.law.constraint(x) if self.constants is None else self.constants


class BackwardDifference(AbstractObserver):
    """x as seen, v = (y − y₋)/dt onto ker DΦ: half a frame late and with noise σ_y √2/dt; the comparison.

    A frame that did not arrive leaves position and velocity as they were.

    Attributes:
        law: for the constraints.
        dt: seconds between frames.
    """

    law: ConstrainedLagrangian
    dt: float

    def update(
        self, belief: Belief, seen: Float[Array, "dim"], arrived: Bool[Array, ""], u: Float[Array, "l"]
    ) -> Belief:
        """The difference to the last position."""
        n = belief.sightings
        x, v = belief.state.coordinates
        v = self.law.project_velocity(seen, jnp.where(n == 0, 0.0, (seen - x) / self.dt))
        state = State(Motion(seen, v), {"constants": self.law.constraint(seen)})
        return _choose(~arrived, belief, Belief(state, jnp.zeros_like(seen), n + 1))


def _choose(old_stays: Array, old: Belief, new: Belief) -> Belief:
    return jax.tree.map(lambda a, b: jnp.where(old_stays, a, b), old, new)
