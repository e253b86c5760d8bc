"""The stable rest pose of a mechanism, and its small oscillations."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld.mechanics.force import SumDissipation
from keycld.mechanics.forces.coulomb import CoulombFriction
from keycld.mechanics.lagrangian import ConstrainedLagrangian

# Steps of the descent, and how small the force must be at rest, as a share of the largest one that was met.
_DESCENT, _STILL = 5000, 1e-6
# ω² below this share of the largest counts as zero: along that direction any pose is as good.
_FREE = 1e-6
# ω² that differ by less than this share of the largest are equal.
_EQUAL = 1e-9


class RestPose(NamedTuple):
    """A stable rest pose.

    Attributes:
        x: positions `[dim]`.
        basis: orthonormal columns of ker DΦ there `[dim, m]`.
        free: so many of the m directions have no restoring force.
    """

    x: Float[np.ndarray, "dim"]
    basis: Float[np.ndarray, "dim m"]
    free: int


class Oscillations(NamedTuple):
    """Small oscillations about a rest pose, slowest first; directions without a restoring force are left out.

    Attributes:
        periods: 2π/ω of the motion without friction, seconds.
        damping_ratios: ζ: an amplitude falls like exp(−ζωt).
    """

    periods: Float[Array, "modes"]
    damping_ratios: Float[Array, "modes"]


def rest_pose(
    law: ConstrainedLagrangian, constants: Float[Array, "n"], observed: Float[np.ndarray, "M dim"]
) -> RestPose | None:
    """Return the minimum of V on the constraints downhill from the observed pose with the lowest V; None without one.

    Call it inside `jax.enable_x64(True)`.
    """
    x, force, largest = _descended(law, constants, jnp.asarray(observed))
    if not (np.all(np.isfinite(x)) and float(force) <= _STILL * float(largest)):
        return None
    pose = np.asarray(x)
    _, values, vectors = np.linalg.svd(np.asarray(law.jacobian(x)).reshape(-1, len(pose)), full_matrices=True)
    basis = vectors[int(np.sum(values > 1e-8 * values.max(initial=0.0))) :].T
    stiffness, mass, _ = eqx.filter_jit(_reduced)(law, constants, RestPose(pose, basis, 0))
    squares = np.real(np.linalg.eigvals(np.linalg.solve(np.asarray(mass), np.asarray(stiffness))))
    least = _FREE * np.abs(squares).max(initial=0.0)
    if squares.size == 0 or squares.min() < -least or squares.max() <= 0:
        return None
    return RestPose(pose, basis, int(np.sum(squares <= least)))


def oscillations(law: ConstrainedLagrangian, constants: Float[Array, "n"], pose: RestPose) -> Oscillations:
    """Compute small oscillations K y = ω² M y on ker DΦ, K = ∇²(V + λ·Φ) with the constraint forces λ at rest.

    The result has derivatives by the law's parameters and the constants: a Newton step from the known pose carries
    those of the pose.

    Args:
        law: M, V, R, Φ.
        constants: values of Φ.
        pose: of `rest_pose` for these parameters.
    """
    stiffness, mass, friction = _reduced(law, constants, pose)
    squares, modes = _modes(_whitened(stiffness, mass))
    rates = jnp.sqrt(squares[pose.free :])
    damping = jnp.diagonal(modes.T @ _whitened(friction, mass) @ modes)[pose.free :]
    return Oscillations(2 * jnp.pi / rates, damping / (2 * rates))


def viscous_rate(law: ConstrainedLagrangian, constants: Float[Array, "n"], pose: RestPose) -> Float[Array, ""]:
    """Return γ of v̇ = −γ v + …, 1/s: tr(M⁻¹ C) / m on the m directions of ker DΦ at rest, C = ∂²R/∂v².

    Only friction in proportion to the velocity counts. Where all parts have the same γ it is this.
    """
    _, mass, friction = _reduced(law, constants, pose)
    return jnp.trace(_whitened(friction, mass)) / friction.shape[0]


def coulomb_decelerations(
    law: ConstrainedLagrangian, constants: Float[Array, "n"], pose: RestPose, friction: CoulombFriction
) -> Float[Array, "modes"]:
    """Return by how much dry friction slows each small oscillation, image-plane units/s²: Σᵢ cᵢ |yᵢ| / yᵀ M y.

    y is the oscillation's direction, scaled so that the keypoint that moves most has |yᵢ| = 1: the number is the
    deceleration of this keypoint. For a single part it is c/m.
    """
    stiffness, mass, _ = _reduced(law, constants, pose)
    _, modes = _modes(_whitened(stiffness, mass))
    y = jnp.asarray(pose.basis) @ jax.scipy.linalg.solve_triangular(jnp.linalg.cholesky(mass).T, modes, lower=False)
    moved = jnp.sqrt(jnp.sum(y.reshape(-1, 2, y.shape[1]) ** 2, axis=1) + 1e-30)
    # yᵀ M y is 1 before y is scaled by its largest |yᵢ|.
    return (friction.strength @ moved * jnp.max(moved, axis=0))[pose.free :]


def _reduced(
    law: ConstrainedLagrangian, constants: Float[Array, "n"], pose: RestPose
) -> tuple[Float[Array, "m m"], Float[Array, "m m"], Float[Array, "m m"]]:
    """Return stiffness, mass and friction matrix on ker DΦ at the pose, which follows the parameters."""
    x, n = jnp.asarray(pose.x), constants.shape[0]

    def lagrangian(x: Array, multipliers: Array) -> Array:
        return law.potential_energy(x) + jnp.sum(multipliers * (law.constraint(x) - constants))

    inverse = jnp.linalg.pinv(jax.lax.stop_gradient(law.jacobian(x)))
    multipliers = -jax.lax.stop_gradient(inverse.T @ jax.grad(law.potential)(x))
    both = jnp.concatenate([x, multipliers])

    def slope(both: Array) -> Array:
        return jnp.concatenate(jax.grad(lagrangian, argnums=(0, 1))(both[: len(x)], both[len(x) :]))

    newton = jnp.linalg.pinv(jax.lax.stop_gradient(jax.jacfwd(slope)(both)), rtol=1e-10)
    both = both - newton @ slope(both)
    x, multipliers = both[: len(pose.x)], both[len(pose.x) :]
    basis = jnp.asarray(pose.basis)
    if n:
        basis = basis - inverse @ law.jacobian(x) @ basis
    stiffness = jax.hessian(lagrangian)(x, multipliers)
    friction = jax.hessian(lambda v: _viscous(law, x, v))(jnp.zeros_like(x))
    mass = jnp.kron(law.mass.matrix, jnp.eye(2))
    return basis.T @ stiffness @ basis, basis.T @ mass @ basis, basis.T @ friction @ basis


def _viscous(law: ConstrainedLagrangian, x: Array, v: Array) -> Array:
    """Return the part of R whose forces are in proportion to the velocity."""
    terms = law.dissipation.terms.values() if isinstance(law.dissipation, SumDissipation) else ()
    return sum((term(x, v) for term in terms if term.viscous), jnp.zeros(()))


def _modes(matrix: Float[Array, "m m"]) -> tuple[Float[Array, "m"], Float[Array, "m m"]]:
    """Return the eigenvalues ω² of a symmetric matrix A and its eigenvectors y, with first derivatives.

        d(ω_k²) = y_kᵀ dA y_k,    dy_k = Σ_j y_j (y_jᵀ dA y_k) / (ω_k² − ω_j²)

    Modes of one frequency, such as both of a ball on a spring that moves in the plane, stay as they are: each
    combination of them is as good, and the derivative of `eigh` divides by zero.
    """
    squares, modes = jnp.linalg.eigh(jax.lax.stop_gradient(matrix))
    turned = modes.T @ matrix @ modes
    gaps = squares[None, :] - squares[:, None]
    apart = jnp.abs(gaps) > _EQUAL * jnp.max(jnp.abs(squares))
    mixed = jnp.where(apart, turned / jnp.where(apart, gaps, 1.0), 0.0)
    return jnp.diagonal(turned), modes + modes @ (mixed - jax.lax.stop_gradient(mixed))


def _whitened(matrix: Float[Array, "m m"], mass: Float[Array, "m m"]) -> Float[Array, "m m"]:
    """Return L⁻¹ A L⁻ᵀ with mass = L Lᵀ."""
    root = jnp.linalg.cholesky(mass)
    half = jax.scipy.linalg.solve_triangular(root, matrix, lower=True)
    return jax.scipy.linalg.solve_triangular(root, half.T, lower=True)


@eqx.filter_jit
def _descended(law: ConstrainedLagrangian, constants: Array, observed: Array) -> tuple[Array, Array, Array]:
    """Return where a descent of V on the constraints ends, the force there, and the largest force on the way."""
    energies = jax.vmap(law.potential_energy)(observed)
    start = law.project_position(observed[jnp.argmin(energies)], constants)

    def downhill(x: Array) -> Array:
        return law.project_velocity(x, -law.over_mass(jax.grad(law.potential)(x)))

    def improve(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        x, rate, largest, taken = carry
        way = downhill(x)
        new = law.project_position(x + rate * way, constants)
        better = law.potential_energy(new) < law.potential_energy(x)
        largest = jnp.maximum(largest, jnp.linalg.norm(way))
        rate = jnp.where(better, 1.3 * rate, 0.3 * rate)
        return jnp.where(better, new, x), rate, largest, taken + 1

    def unfinished(carry: tuple[Array, Array, Array, Array]) -> Array:
        x, rate, largest, taken = carry
        return (taken < _DESCENT) & (rate > 1e-30) & (jnp.linalg.norm(downhill(x)) > _STILL * largest)

    most = jnp.linalg.norm(jax.vmap(downhill)(observed), axis=1).max()
    first = 0.01 / jnp.maximum(most, 1e-30)
    x, _, largest, _ = jax.lax.while_loop(unfinished, improve, (start, first, most, jnp.array(0)))
    return x, jnp.linalg.norm(downhill(x)), largest
