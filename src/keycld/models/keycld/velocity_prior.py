"""The prior of the initial velocity."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld.mechanics import ConstrainedLagrangian, MechanicalDynamics, Motion, State, matmul
from keycld.models.keycld.initial_state import AbstractInitialState

# ν. Observation errors have heavy tails: on acrobot and cartpole their quantiles are those of Student's t with 4.
_TAIL = 4
# Times since rest in units of τ, and how far the true one may be from it: half of the gaps between them. The first is
# what the recordings show; the others are motions taken up later.
_TIMES = np.array([1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 16.0])
_APART = np.array([0.0, 0.5, 0.5, 0.75, 1.0, 1.25, 2.0, 2.5])
# The prior probability of the first time is one half of that of an arbitrary velocity; the later ones share as much.
_WEIGHTS = np.array([0.5, *(0.5 / 7,) * 7])


# Distance beyond which an error of a prediction counts linearly instead of squared, image-plane units.
_SCALE = 0.03


class VelocityPrior(eqx.Module):
    """The prior of the initial velocity: most recordings of a mechanism show it released from rest, or nearly so.

    A motion that was at rest a short time t before its first frame has the initial velocity v ≈ t a, where a(x, u) is
    the learned acceleration at rest; a recording from the middle of a motion has any initial velocity. Two frames alone
    give the velocity to a few hundredths of a pixel a frame, and this error limits how long a prediction is valid.
    Bayes' rule, approximated, with n degrees of freedom and the times t_j = k_j τ, k = 1, 2, 3, 4, 6, 8, 11, 16:

        v = t a + b_j,  t ~ N(t_j, δ_j²), b_j ~ N(0, k_j² σ_b²), weight π_j;   or   v ~ N(0, σ_v²), weight 1
        v_s = v + e,  e ~ Student's t_ν(0, σ_s²);   d_j = v_s − t_j a = d_∥ + d_⊥, along a and across it
        q_⊥ = k_j² σ_b², q_∥ = q_⊥ + δ_j² |a|²,   s² = σ_s² + q,   D_j = |d_∥|²/s_∥² + |d_⊥|²/s_⊥²
        p_j = π_j s_∥⁻¹ s_⊥¹⁻ⁿ (1 + D_j/ν)^(−(ν+n)/2),   p_v = σ_v⁻ⁿ exp(−|v_s|²/2σ_v²),   r_j = p_j / (p_v + Σ p_i)
        v̂ = v_s − Σ r_j [w_j σ_s² / (w_j σ_s² + q)] d_j for both parts of d_j,   w_j = (ν + D_j) / (ν + n)

    with π_1 = 1/2, the other π_j = 1/14, δ_1 = 0 and the other δ_j half of the gaps between the times. The later times
    keep a motion that was taken up a few frames after rest from being pulled back to t = τ, and tell that its velocity
    is about parallel to a. An observed velocity v_s that is far from all t a stays as observed. The weight w_j
    estimates the size of the error e. Approximations: b_j + e is treated as one Student's t, its normalisation relative
    to the normal distribution is left out (1.06 for n = 1, 1 for n = 2), σ_s is neglected compared with σ_v, and a is
    that of the first frame. The numbers are measured on training recordings (`measured`), not trained;
    losses use the observed velocity. Ours, in no paper.

    Attributes:
        elapsed: τ, seconds; about dt where the first frame is one step after rest.
        spread: σ_b of one component of a velocity, image-plane units a second.
        observation: σ_s of one component, image-plane units a second; 0 before it is measured: no change.
        speed: σ_v of one component, image-plane units a second.
    """

    elapsed: Float[Array, ""]
    spread: Float[Array, ""]
    observation: Float[Array, ""]
    speed: Float[Array, ""]

    @classmethod
    def unknown(cls) -> "VelocityPrior":
        """Return the prior before it is measured, which changes no velocity."""
        zero, one = jnp.zeros(()), jnp.ones(())
        return cls(zero, one, zero, one)

    @classmethod
    def measured(
        cls,
        dynamics: MechanicalDynamics,
        initial_state: AbstractInitialState,
        keypoints: Float[Array, "N T dim"],
        u: Float[Array, "N *T l"],
        dt: Float[Array, ""],
    ) -> "VelocityPrior":
        """Return the prior that recordings show.

        τ is the time after rest whose velocities τ a predict the recordings best. σ_s² / (σ_s² + σ_b²) is the best step
        from the observed velocities v_s towards τ a, as a share of their difference d. σ_s² + σ_b² is the median of
        |d|² for each degree of freedom, so that a minority of recordings may have any initial velocity.

        Args:
            dynamics: with a constrained Lagrangian.
            initial_state: gives v_s.
            keypoints: of recordings from their first frame on.
            u: inputs, constant or held from each frame on; more frames than `keypoints` have are not read.
            dt: seconds between frames.
        """
        law, given = dynamics.law, initial_state.given
        assert isinstance(law, ConstrainedLagrangian)
        freedom = law.freedom
        initial = jax.vmap(lambda x, u: initial_state(dynamics, x[:given], dt, u))(keypoints, u)
        x, observed = initial.coordinates
        # The input of the last frame acts after it.
        first, acting = (u, u) if u.ndim == 2 else (u[:, 0], u[:, : keypoints.shape[1] - 1])
        acceleration = jax.vmap(lambda x, u: law.acceleration(x, jnp.zeros_like(x), u))(x, first)

        def error(v: jax.Array) -> jax.Array:
            """Return the robust error of predictions with these initial velocities; diverged ones count little."""
            states = State(Motion(x, v), initial.parameters)
            paths = jax.vmap(lambda state, u: dynamics.rollout(state, u, dt, keypoints.shape[1] - 1).x)(states, acting)
            far = jnp.nan_to_num(jnp.sum((paths - keypoints) ** 2, axis=-1), nan=1.0, posinf=1.0)
            return jnp.mean(jnp.sqrt(1 + far / _SCALE**2))

        def best(choices: jax.Array, velocities: Callable[[jax.Array], jax.Array]) -> jax.Array:
            return choices[jnp.argmin(jax.lax.map(lambda choice: error(velocities(choice)), choices))]

        elapsed = best(dt * jnp.linspace(0.0, 3.0, 31), lambda elapsed: elapsed * acceleration)
        off = observed - elapsed * acceleration
        part = best(jnp.linspace(0.0, 1.0, 21), lambda part: observed - part * off)
        # The median of χ² with n degrees of freedom is near n (1 − 2/9n)³.
        variance = jnp.nanmedian(jnp.sum(off**2, axis=-1)) / (freedom * (1 - 2 / (9 * freedom)) ** 3) + 1e-12
        speed = jnp.sqrt(jnp.mean(jnp.sum(jnp.diff(keypoints, axis=1) ** 2, axis=-1)) / freedom) / dt
        return cls(elapsed, jnp.sqrt((1 - part) * variance), jnp.sqrt(part * variance), speed)

    def __call__(
        self,
        dynamics: MechanicalDynamics,
        state: State,
        u: Float[Array, "l"],
        covariance: Float[Array, "size size"] | None = None,
    ) -> State:
        """Return the state with the expected velocity v̂, and the position moved as far as it depends on the velocity.

        Args:
            dynamics: with a constrained Lagrangian, which gives a and n.
            state: at the first frame, with the observed velocity v_s.
            u: the input at that frame.
            covariance: of (x, v_s) [4K, 4K]; None: the velocity's is σ_s², that of two frames.
        """
        law, (x, v) = dynamics.law, state.coordinates
        assert isinstance(law, ConstrainedLagrangian)
        dim = x.shape[0]
        rest = law.acceleration(x, jnp.zeros_like(x), u)
        off = v[None] - self.elapsed * jnp.outer(_TIMES, rest)
        if covariance is None:
            observed, mixed = self.observation**2, jnp.zeros((dim, dim))
        else:
            observed, mixed = jnp.trace(covariance[dim:, dim:]) / law.freedom, covariance[:dim, dim:]
        size = jnp.sum(rest**2)
        along = (matmul(off, rest) / (size + 1e-12))[:, None] * rest[None]
        parts = jnp.stack([jnp.sum(along**2, -1), jnp.sum((off - along) ** 2, -1)])
        across = (self.spread * _TIMES) ** 2
        spread = jnp.stack([across + (self.elapsed * _APART) ** 2 * size, across])
        variance = observed + spread
        far = jnp.sum(parts / variance, 0)
        volume = jnp.log(variance[0]) + (law.freedom - 1) * jnp.log(variance[1])
        released = np.log(_WEIGHTS) - ((_TAIL + law.freedom) * jnp.log1p(far / _TAIL) + volume) / 2
        moving = -(jnp.sum(v**2) / self.speed**2 + law.freedom * jnp.log(self.speed**2)) / 2
        share = jax.nn.softmax(jnp.append(released, moving))[:-1]
        error = (_TAIL + far) / (_TAIL + law.freedom) * observed
        forward, aside = share[None] * error[None] / (error[None] + spread)
        pull = matmul(forward, along) + matmul(aside, off - along)
        carried = matmul(mixed, pull) / (observed + 1e-12)
        return State(Motion(x - carried, v - pull), state.parameters)
