"""What recordings usually begin with."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.mechanics import ConstrainedLagrangian, MechanicalDynamics, Motion, State

# ν. Errors of sightings have heavy tails: on acrobot and cartpole their quantiles are those of Student's t with 4.
_TAIL = 4


class Beginning(eqx.Module):
    """The prior of a first velocity: whoever records a machine mostly lets it go from rest, or nearly.

    A motion that was at rest τ before its first frame begins with v ≈ τ a, where a(x, u) is the learned acceleration at
    rest; a motion that is taken up in its middle begins with any velocity. Two pictures alone tell the velocity no
    better than to a few hundredths of a pixel a frame, which decides how long a prediction holds. Nearly by Bayes'
    rule, with n degrees of freedom and as much belief in either kind before anything is seen,

        v = τ a + b,  b ~ N(0, σ_b²)   or   v ~ N(0, σ_v²);      v_s = v + e,  e ~ Student's t_ν(0, σ_s²)
        d = v_s − τ a,   s² = σ_s² + σ_b²
        r = P(begun | v_s) = 1 / (1 + (1 + |d|²/νs²)^((ν+n)/2) (s/σ_v)ⁿ exp(−|v_s|²/2σ_v²))
        v̂ = v_s − r w σ_s² / (w σ_s² + σ_b²) d,   w = (ν + |d|²/s²) / (ν + n)

    A velocity that is far from τ a stays what was seen. w says how large this error e seems to be. Nearly: b + e is
    taken for a Student's t of its own, whose constant beside the normal distribution's is left out (1.06 for n = 1,
    1 for n = 2), and σ_s for nothing beside σ_v. The numbers are
    measured on training recordings, not trained; losses judge what was seen alone. Fresh ones know nothing and change
    nothing (σ_s = 0).

    - `elapsed`: τ, seconds. About one frame where recordings begin one frame after rest.
    - `spread`: σ_b. `sighting`: σ_s. `speed`: σ_v. Of one component of a velocity, image-plane units a second.
    """

    elapsed: Float[Array, ""]
    spread: Float[Array, ""]
    sighting: Float[Array, ""]
    speed: Float[Array, ""]

    @classmethod
    def unknown(cls) -> "Beginning":
        """Before anything is measured."""
        zero, one = jnp.zeros(()), jnp.ones(())
        return cls(zero, one, zero, one)

    def __call__(self, dynamics: MechanicalDynamics, state: State, u: Float[Array, "l"]) -> State:
        """The state with the velocity that is likelier; `u` acts at its frame."""
        law, (x, v) = dynamics.law, state.coordinates
        assert isinstance(law, ConstrainedLagrangian)
        off = v - self.elapsed * law.acceleration(x, jnp.zeros_like(v), u)
        variance = self.sighting**2 + self.spread**2
        far = (off @ off) / variance
        odds = (v @ v) / self.speed**2 + law.freedom * jnp.log(self.speed**2 / variance)
        odds = (odds - (_TAIL + law.freedom) * jnp.log1p(far / _TAIL)) / 2
        error = (_TAIL + far) / (_TAIL + law.freedom) * self.sighting**2
        pull = jax.nn.sigmoid(odds) * error / (error + self.spread**2)
        return State(Motion(x, v - pull * off), state.parameters)
