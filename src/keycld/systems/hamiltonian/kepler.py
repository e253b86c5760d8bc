"""Kepler's problem in closed form, for every conic."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_ITERATIONS = 12
# Below this |ψ| the formulae of the Stumpff functions lose digits and their series are exact.
_SMALL = 1e-2


def kepler(
    position: Float[Array, "d"], velocity: Float[Array, "d"], strength: Float[Array, ""], time: Float[Array, ""]
) -> tuple[Float[Array, "d"], Float[Array, "d"]]:
    """Compute position and velocity after `time` of r̈ = −μ r / |r|³, from those at time zero.

    Kepler's equation in the universal anomaly χ, √μ t = r₀ χ (1 − ψ S) + (r₀·v₀/√μ) χ² C + χ³ S with
    ψ = (2/r₀ − v₀²/μ) χ² and Stumpff's C(ψ) and S(ψ), is solved by Laguerre's method as Conway (1986) proposes,
    which finds the root from any guess; then Lagrange's f and g give the state. Ellipses, parabolas and hyperbolas
    alike; good to about 1e-13 in float64.

    Args:
        position: r₀, not zero.
        velocity: v₀.
        strength: μ > 0.
        time: t ≥ 0.
    """
    root = jnp.sqrt(strength)
    r0 = jnp.sqrt(jnp.sum(position**2))
    sigma = jnp.sum(position * velocity) / root
    alpha = 2 / r0 - jnp.sum(velocity**2) / strength

    def lengths(chi):
        psi = alpha * chi**2
        c, s = _stumpff(psi)
        passed = r0 * chi * (1 - psi * s) + sigma * chi**2 * c + chi**3 * s  # √μ t
        radius = r0 * (1 - psi * c) + sigma * chi * (1 - psi * s) + chi**2 * c
        slope = sigma * (1 - psi * c) + (1 - alpha * r0) * chi * (1 - psi * s)  # of the radius
        return passed, radius, slope, c, s

    def improve(_, chi):
        passed, radius, slope, _, _ = lengths(chi)
        gap = passed - root * time
        under = jnp.sqrt(jnp.abs(16 * radius**2 - 20 * gap * slope))
        return chi - 5 * gap / (radius + jnp.sign(radius) * under)

    # Guesses that grow as the solution does: with time on ellipses, with its logarithm on hyperbolas.
    bend = jnp.sqrt(jnp.maximum(-alpha, 1e-12))
    guess = jnp.where(alpha > 0, root * time * alpha, jnp.arcsinh(root * time * bend / r0) / bend)
    chi = jax.lax.fori_loop(0, _ITERATIONS, improve, guess)
    _, radius, _, c, s = lengths(chi)
    psi = alpha * chi**2
    f, g = 1 - chi**2 * c / r0, time - chi**3 * s / root
    f_rate, g_rate = root * chi * (psi * s - 1) / (radius * r0), 1 - chi**2 * c / radius
    return f * position + g * velocity, f_rate * position + g_rate * velocity


def _stumpff(psi: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Compute C = (1 − cos √ψ)/ψ and S = (√ψ − sin √ψ)/√ψ³, with cosh and sinh where ψ is negative."""
    size = jnp.where(jnp.abs(psi) < _SMALL, 1.0, jnp.abs(psi))
    root = jnp.sqrt(size)
    c = jnp.where(psi > 0, 1 - jnp.cos(root), jnp.cosh(root) - 1) / size
    s = jnp.where(psi > 0, root - jnp.sin(root), jnp.sinh(root) - root) / (size * root)
    near_c = 1 / 2 - psi / 24 * (1 - psi / 30 * (1 - psi / 56))
    near_s = 1 / 6 - psi / 120 * (1 - psi / 42 * (1 - psi / 72))
    small = jnp.abs(psi) < _SMALL
    return jnp.where(small, near_c, c), jnp.where(small, near_s, s)
