"""The prior of the initial velocity."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.mechanics import ConstrainedLagrangian, MechanicalDynamics, Motion, State

# ν. Observation errors have heavy tails: on acrobot and cartpole their quantiles are those of Student's t with 4.
_TAIL = 4


class VelocityPrior(eqx.Module):
    """The prior of the initial velocity: most recordings of a mechanism show it released from rest, or nearly so.

    A motion that was at rest a time τ before its first frame has the initial velocity v ≈ τ a, where a(x, u) is the
    learned acceleration at rest; a recording from the middle of a motion has any initial velocity. Two frames alone
    give the velocity to a few hundredths of a pixel a frame, and this error limits how long a prediction is valid.
    Bayes' rule, approximated, with n degrees of freedom and equal prior probability of both kinds:

        v = τ a + b,  b ~ N(0, σ_b²)   or   v ~ N(0, σ_v²);      v_s = v + e,  e ~ Student's t_ν(0, σ_s²)
        d = v_s − τ a,   s² = σ_s² + σ_b²
        r = P(released | v_s) = 1 / (1 + (1 + |d|²/νs²)^((ν+n)/2) (s/σ_v)ⁿ exp(−|v_s|²/2σ_v²))
        v̂ = v_s − r w σ_s² / (w σ_s² + σ_b²) d,   w = (ν + |d|²/s²) / (ν + n)

    An observed velocity v_s that is far from τ a stays as observed. The weight w estimates the size of this error e.
    Approximations: b + e is treated as one Student's t, its normalisation relative to the normal distribution is left
    out (1.06 for n = 1, 1 for n = 2), and σ_s is neglected compared with σ_v. The numbers are measured on training
    recordings (`measure_velocity_prior`), not trained; losses use the observed velocity. Ours, in no paper.

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
        off = v - self.elapsed * law.acceleration(x, jnp.zeros_like(x), u)
        if covariance is None:
            observed, mixed = self.observation**2, jnp.zeros((dim, dim))
        else:
            observed, mixed = jnp.trace(covariance[dim:, dim:]) / law.freedom, covariance[:dim, dim:]
        variance = observed + self.spread**2
        far = (off @ off) / variance
        odds = (v @ v) / self.speed**2 + law.freedom * jnp.log(self.speed**2 / variance)
        odds = (odds - (_TAIL + law.freedom) * jnp.log1p(far / _TAIL)) / 2
        error = (_TAIL + far) / (_TAIL + law.freedom) * observed
        pull = jax.nn.sigmoid(odds) * error / (error + self.spread**2)
        carried = jnp.matmul(mixed, off, precision="highest") / (observed + 1e-12)
        return State(Motion(x - pull * carried, v - pull * off), state.parameters)
