"""The equation of motion of a chain in its joints, identified from measured torques and forces."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld._errors import KeycldError
from keycld.mechanics.forces.springs import quadratic_form
from keycld.mechanics.joint_coordinates import Joint, joint_positions
from keycld.mechanics.residuals import autocovariance, lagged_products

# Joint speed, rad/s or m/s, below which dry friction falls to zero.
_SLOW = 0.05
# Seconds of a window of the balance, and samples of the local cubics that give positions and velocities.
_WINDOW, _CUBIC = 0.25, 7


class JointLaw(eqx.Module):
    """A chain of links and slides with friction in its joints, linear in all numbers; SI units, or those of the torque.

    With the keypoints x(q) and their velocities v = (∂x/∂q) q̇:

        L = ½ Σᵢⱼ mᵢⱼ vᵢ·vⱼ − Σᵢ wᵢ yᵢ − ½ Σⱼ kⱼ qⱼ²,    d/dt ∂L/∂q̇ − ∂L/∂q + b q̇ + c q̇/√(q̇² + ε²) + o = τ

    Attributes:
        mass: m [K, K], of which the lower triangle counts.
        weight: w [K], straight down where all joint coordinates are zero; 0 for the keypoints of slides, where it is no
            other than a constant force.
        stiffness: k [d] of springs on slides; 0 for hinges.
        viscous: b [d].
        dry: c [d].
        offset: o [d], a constant torque, such as the zero of the sensor; of a slide also where its spring rests.
        joints: of the chain.
        lengths: of the links [d].
    """

    mass: Float[Array, "K K"]
    weight: Float[Array, "K"]
    stiffness: Float[Array, "d"]
    viscous: Float[Array, "d"]
    dry: Float[Array, "d"]
    offset: Float[Array, "d"]
    joints: tuple[Joint, ...] = eqx.field(static=True)
    lengths: tuple[float, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, theta: Array, joints: tuple[Joint, ...], lengths: tuple[float, ...]) -> "JointLaw":
        """Return the law with the numbers θ: lower triangle of m; w, or k on a slide, of each keypoint; b; c; o."""
        d = len(joints)
        rows, columns = np.tril_indices(d)
        mass = jnp.zeros((d, d), theta.dtype).at[rows, columns].set(theta[: rows.size])
        pull, viscous, dry, offset = theta[rows.size :].reshape(4, d)
        slides, moved = np.array([joint.slide for joint in joints]), np.array([joint.keypoint for joint in joints])
        weight = pull * np.logical_not(slides)[np.argsort(moved)]
        return cls(mass, weight, pull[moved] * slides, viscous, dry, offset, joints, lengths)

    def momentum(self, q: Float[Array, "d"], rate: Float[Array, "d"]) -> Float[Array, "d"]:
        """Return ∂L/∂q̇."""
        return jax.grad(self._lagrangian, argnums=1)(q, rate)

    def resistance(self, q: Float[Array, "d"], rate: Float[Array, "d"]) -> Float[Array, "d"]:
        """Return −∂L/∂q, friction and offset: what the torque has to overcome besides the change of the momentum."""
        friction = self.viscous * rate + self.dry * rate / jnp.sqrt(rate**2 + _SLOW**2)
        return friction + self.offset - jax.grad(self._lagrangian)(q, rate)

    def inertia(self, q: Float[Array, "d"]) -> Float[Array, "d d"]:
        """Return ∂²L/∂q̇²."""
        return jax.jacfwd(self.momentum, argnums=1)(q, jnp.zeros_like(q))

    def acceleration(
        self, q: Float[Array, "d"], rate: Float[Array, "d"], torque: Float[Array, "d"]
    ) -> Float[Array, "d"]:
        """Return q̈."""
        along = jax.jvp(lambda q: self.momentum(q, rate), (q,), (rate,))[1]
        return jnp.linalg.solve(self.inertia(q), torque - self.resistance(q, rate) - along)

    def gravity_torques(self) -> Float[Array, "d"]:
        """Return the largest torque of gravity of each hinge, all else hanging down; 0 for slides."""
        carried = [[other.keypoint for other in self.joints[k:]] for k in range(len(self.joints))]
        return jnp.stack(
            [
                jnp.zeros(()) if joint.slide else length * jnp.sum(self.weight[jnp.array(beyond)])
                for joint, length, beyond in zip(self.joints, self.lengths, carried, strict=True)
            ]
        )

    def _lagrangian(self, q: Array, rate: Array) -> Array:
        x, v = jax.jvp(lambda q: joint_positions(self.joints, q, jnp.asarray(self.lengths, q.dtype)), (q,), (rate,))
        springs = 0.5 * jnp.sum(self.stiffness * q**2)
        return 0.5 * quadratic_form(self.mass, v) - jnp.sum(self.weight * x.reshape(-1, 2)[:, 1]) - springs


class FittedJointLaw(NamedTuple):
    """The result of `fit_joint_law`.

    Attributes:
        theta: all numbers of the law.
        covariance: of θ.
        noise: standard deviation of the torque of a sample that the law leaves unexplained [d].
        rate_noise: standard deviation of the joint positions about local cubics [d].
    """

    theta: np.ndarray
    covariance: np.ndarray
    noise: np.ndarray
    rate_noise: np.ndarray


def fit_joint_law(
    joints: tuple[Joint, ...],
    lengths: tuple[float, ...],
    q: Float[np.ndarray, "T d"],
    torque: Float[np.ndarray, "T d"],
    dt: float,
) -> FittedJointLaw:
    """Find the law that balances measured torques, by linear least squares over short windows.

    Encoders are exact compared with measured torques, so the error is in the torque, and no motion is simulated: a fit
    of simulated motions would take errors of the torque for causes of motion, and find too large an inertia. With a
    smooth bump φ over each window,

        ∫ φ τ dt = ∫ (−φ̇ ∂L/∂q̇ + φ (−∂L/∂q + friction + offset)) dt

    holds exactly and needs no acceleration, whose noise would make inertias too small. Windows overlap by three
    quarters; the covariance counts the autocovariance of their errors.

    Args:
        joints: of the chain.
        lengths: of the links.
        q: joint positions.
        torque: of each joint, a force on a slide; 0 where none acts; held from each sample to the next.
        dt: seconds between samples.

    Raises:
        KeycldError: the log is too short, or its motion does not determine the law.
    """
    half = max(4, round(_WINDOW / dt / 2))
    place, rate, scatter = _cubics(q, dt)
    # A torque that changes at a sample acts on the bump around it half before, half after.
    held = np.concatenate([torque[:1], (torque[:-1] + torque[1:]) / 2])[_CUBIC // 2 : len(torque) - _CUBIC // 2]
    span = np.linspace(-1, 1, 2 * half + 1)
    bump, slope = (1 - span**2) ** 4, -8 * span * (1 - span**2) ** 3 / (half * dt)
    begins = np.arange(0, len(place) - 2 * half, max(1, half // 2))
    d = len(joints)
    size = d * (d + 1) // 2 + 4 * d
    too_few = KeycldError(f"{len(place)} samples are too few to find {size} numbers: use a longer log.")
    if len(begins) * d < 2 * size:
        raise too_few
    with jax.enable_x64(True):
        change, resist = (
            np.asarray(part) for part in _columns(joints, lengths, size, jnp.asarray(place), jnp.asarray(rate))
        )
    rows = np.stack(
        [
            np.einsum("t,tdp->dp", bump, resist[b : b + 2 * half + 1])
            - np.einsum("t,tdp->dp", slope, change[b : b + 2 * half + 1])
            for b in begins
        ]
    )
    target = np.stack([bump @ held[b : b + 2 * half + 1] for b in begins])
    matrix = rows.reshape(-1, size)
    scale = np.linalg.norm(matrix, axis=0)
    values = np.linalg.svd(matrix / np.where(scale > 0, scale, 1.0), compute_uv=False)
    if not np.all(scale > 0) or values[-1] < 1e-5 * values[0]:
        raise KeycldError(
            "the motion of this log does not determine inertia, weight and friction: move all joints more."
        )
    theta = np.linalg.lstsq(matrix, target.reshape(-1), rcond=None)[0]
    error = target - rows @ theta
    inverse = np.linalg.inv(matrix.T @ matrix)
    middle = sum(lagged_products(rows[None, :, k], autocovariance(error[None, :, k])) for k in range(d))
    # n/(n − p) for correlated errors of covariance Σ: the fit takes tr X (XᵀX)⁻¹ Xᵀ Σ from the sum of their squares.
    left, taken = np.sum(error**2), np.trace(inverse @ middle)
    if taken >= left:
        raise too_few
    share = left / (left - taken)
    # The noise of a window is that of its samples, √Σφ² of one.
    noise = np.sqrt(np.mean(error**2, axis=0) * share / np.sum(bump**2))
    return FittedJointLaw(theta, inverse @ middle @ inverse * share, noise, scatter)


class JointPrediction(NamedTuple):
    """Predicted joint positions with standard errors, `[T, d]` each."""

    q: np.ndarray
    sigma: np.ndarray


def predict_joints(
    fitted: FittedJointLaw,
    joints: tuple[Joint, ...],
    lengths: tuple[float, ...],
    q: Float[np.ndarray, "n d"],
    torque: Float[np.ndarray, "T d"],
    dt: float,
) -> JointPrediction:
    """Predict a motion from its first samples and its torques; errors of the law, start and torques are carried along.

    Args:
        fitted: the law.
        joints: of the chain.
        lengths: of the links.
        q: the first n measured positions, of which a cubic gives position and velocity at the first.
        torque: measured torques, from the first sample on.
        dt: seconds between samples.

    Raises:
        KeycldError: the motion of the law diverges.
    """
    count, d = q.shape
    powers = np.vander(dt * np.arange(count), 4, increasing=True)
    inverse = np.linalg.pinv(powers)
    first, rate = inverse[0] @ q, inverse[1] @ q
    with jax.enable_x64(True):
        arguments = (jnp.asarray(fitted.theta), jnp.asarray(np.stack([first, rate])), jnp.asarray(torque))
        path, slopes = _differentiated(joints, lengths, arguments, dt)
    by_theta, by_start, by_torque = (np.asarray(slope) for slope in slopes)
    # At the end of a cubic, errors of position and velocity are correlated: a position too high has too low a velocity.
    of_start = inverse[:2] @ inverse[:2].T
    with np.errstate(over="ignore", invalid="ignore"):
        variance = np.einsum("tdi,ij,tdj->td", by_theta, fitted.covariance, by_theta)
        variance += np.einsum("tdai,ab,tdbi,i->td", by_start, of_start, by_start, fitted.rate_noise**2)
        variance += np.sum((by_torque * fitted.noise) ** 2, axis=(2, 3))
    if not np.all(np.isfinite(variance)):
        raise KeycldError("the predicted motion diverges, so the law is not that of the rig: move all joints more.")
    return JointPrediction(np.asarray(path), np.sqrt(variance))


@eqx.filter_jit
def _differentiated(joints: tuple[Joint, ...], lengths: tuple[float, ...], arguments: tuple, dt: float) -> tuple:
    def path(theta: Array, start: Array, torque: Array) -> tuple[Array, Array]:
        law = JointLaw.of(theta, joints, lengths)

        def step(state: Array, push: Array) -> tuple[Array, Array]:
            def slope(state: Array) -> Array:
                return jnp.stack([state[1], law.acceleration(state[0], state[1], push)])

            one = slope(state)
            two = slope(state + dt / 2 * one)
            three = slope(state + dt / 2 * two)
            four = slope(state + dt * three)
            return state + dt / 6 * (one + 2 * two + 2 * three + four), state[0]

        q = jax.lax.scan(step, start, torque)[1]
        return q, q

    slopes, q = jax.jacfwd(path, argnums=(0, 1, 2), has_aux=True)(*arguments)
    return q, slopes


@eqx.filter_jit
def _columns(joints: tuple[Joint, ...], lengths: tuple[float, ...], size: int, q: Array, rate: Array) -> tuple:
    """Return the derivatives of momentum and resistance by θ `[T, d, P]`, which do not depend on θ."""

    def both(theta: Array, q: Array, rate: Array) -> tuple[Array, Array]:
        law = JointLaw.of(theta, joints, lengths)
        return law.momentum(q, rate), law.resistance(q, rate)

    return jax.vmap(jax.jacfwd(both), (None, 0, 0))(jnp.zeros(size), q, rate)


def _cubics(q: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position and velocity in the middle of windows of seven samples, and the scatter about their cubics."""
    powers = np.vander(dt * (np.arange(_CUBIC) - _CUBIC // 2), 4, increasing=True)
    inverse = np.linalg.pinv(powers)
    windows = np.lib.stride_tricks.sliding_window_view(q, _CUBIC, axis=0)
    off = windows - windows @ (powers @ inverse).T
    scatter = np.sqrt(np.mean(off**2, axis=(0, 2)) * _CUBIC / (_CUBIC - 4))
    return windows @ inverse[0], windows @ inverse[1], scatter
