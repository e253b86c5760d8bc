"""The circle nearest to points in the plane."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_RIDGE = 1e-6
"""Damping of the normal equations, as a share of their trace: points on a line give a finite circle."""
_ITERATIONS = 10


def nearest_circle(points: Float[Array, "M 2"]) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """Fit a circle to points, by least squares of their distances from it; outliers count less.

        min over p, r of Σ ρ(|xᵢ − p| − r)

    Kåsa's linear fit, |xᵢ|² = 2 p·xᵢ + c, gives a first guess. Gauss–Newton steps with Cauchy weights follow, whose
    width is twice the median distance from the circle. The error of the centre of an arc that spans the angle α grows
    like α⁻².

    Args:
        points: M ≥ 3 of them, image-plane units.

    Returns:
        Centre p and radius r. Points on a line or in one place give a finite result without meaning.
    """
    middle = jnp.mean(points, axis=0)
    x = points - middle[None, :]
    square = jnp.sum(x**2, axis=1)
    normal = jnp.matmul(x.T, x, precision="highest")
    damping = _RIDGE * jnp.trace(normal) * jnp.eye(2) + 1e-12 * jnp.eye(2)
    pull = jnp.matmul(x.T, square - jnp.mean(square), precision="highest")
    centre = 0.5 * jnp.linalg.solve(normal + damping, pull)
    radius = jnp.sqrt(jnp.mean(square) + jnp.sum(centre**2))

    def improve(circle: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        centre, radius = circle
        away = x - centre[None, :]
        distance = jnp.sqrt(jnp.sum(away**2, axis=1) + 1e-12)
        off = distance - radius
        weight = 1 / (1 + (off / (2 * jnp.median(jnp.abs(off)) + 1e-6)) ** 2)
        slopes = jnp.concatenate([-away / distance[:, None], -jnp.ones_like(off)[:, None]], axis=1)
        weighted = (slopes * weight[:, None]).T
        matrix = jnp.matmul(weighted, slopes, precision="highest")
        step = jnp.linalg.solve(
            matrix + _RIDGE * jnp.trace(matrix) * jnp.eye(3), jnp.matmul(weighted, off, precision="highest")
        )
        return (centre - step[:2], radius - step[2]), None

    (centre, radius), _ = jax.lax.scan(improve, (centre, radius), length=_ITERATIONS)
    return centre + middle, radius
