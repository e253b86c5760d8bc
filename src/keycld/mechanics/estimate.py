"""Parameters of a law from observed tracks with their covariance: the last digits of a fit, and its error bars."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from keycld._errors import KeycldError
from keycld.mechanics.dynamics import MechanicalDynamics
from keycld.mechanics.lagrangian import ConstrainedLagrangian
from keycld.mechanics.residuals import autocovariance, deviation, lagged_products, likely_size, places, robust_scale
from keycld.mechanics.sensitivity import Sensitivity, Unknowns, paths, sensitivity
from keycld.mechanics.state import Motion, Scalar

# Errors above so many standard deviations count linearly.
_OUTLIER = 5.0
# A direction is flat if its curvature, with unit curvature along each parameter, is below this.
_FLAT = 1e-11
# Share of a gradient along flat directions with which a constant is not determined.
_LEAK = 1e-4
# The fit ends when a step would gain less than this, in units of the noise's variance, for each unknown.
_DONE, _STEPS = 1e-5, 40
# Errors across a constraint count as at least this share of those along it.
_THIN = 0.05
_DAMPINGS = (0.0, 1e-4, 1e-2, 1e0, 1e2)


class Estimate(NamedTuple):
    """The result of `estimate`, in float64.

    Attributes:
        unknowns: what η = (θ, c) means.
        eta: estimate of η `[P]`.
        covariance: of η `[P, P]`, without flat directions.
        flat: orthonormal columns `[P, F]`: directions of η/`scale` that the tracks do not determine, such as the common
            factor of M, V, R and g.
        scale: `[P]`.
        noise: standard deviation of the observed coordinates of each keypoint, image-plane units `[K]`.
        inefficiency: of each keypoint `[K]`: so many frames are worth one with an independent error.
        initial: initial states `[N, dim]` each.
        paths: fitted positions `[N, T, dim]`.
        dt: seconds between frames.
        uneven: the part of the covariance that errors of keypoints have that return with the place `[P, P]`.
        misfit: root mean square of the errors that last for more than a frame, as a share of that of the motion around
            its mean position. Near 1 the fit has ended in a minimum of the cost that is not the lowest, for example
            with a motion that has fallen back by a period, or the law is another one; the covariance knows of neither.
    """

    unknowns: Unknowns
    eta: np.ndarray
    covariance: np.ndarray
    flat: np.ndarray
    scale: np.ndarray
    noise: np.ndarray
    inefficiency: np.ndarray
    initial: Motion
    paths: np.ndarray
    dt: float
    uneven: np.ndarray
    misfit: float


class Derived(NamedTuple):
    """A number computed from η.

    Attributes:
        value: f(η).
        sigma: its standard error √(∇fᵀ Σ ∇f).
        determined: whether f stays the same along flat directions.
    """

    value: float
    sigma: float
    determined: bool


def estimate(
    dynamics: MechanicalDynamics,
    free: PyTree,
    observed: Float[Array | np.ndarray, "N T dim"],
    u: Float[Array | np.ndarray, "N *T l"],
    dt: Scalar,
    *,
    initial: Motion,
) -> Estimate:
    """Fit the parameters of a law and all initial states to tracks, and compute the covariance of the parameters.

        min over zᵢ, η of Σᵢₜ ρ(Wᵢₜ (x̂ᵢₜ − x(t; zᵢ, η))),    ρ(e) = 25 (√(1 + e²/25) − 1)

    W divides the errors of each keypoint by their deviation, and then those across each constraint and those along all
    of them by theirs. Where a law is not exact, errors along the constraints are many times larger: they are errors of
    time. Those across them are of the observation alone, and tell lengths and pivots. Gauss–Newton steps in float64
    begin at a solution of `fit_motions`. Motions are integrated so finely that the error does not matter, all
    derivatives are exact, and the constants c of Φ, such as squared lengths, are unknowns like all others. Initial
    states vary along the constraints, and are eliminated: G = W dx/dη with the best zᵢ for each η. With S = Gᵀ ρ″ G,

        cov η = S⁻¹ (Σₖ Gₖᵀ Cₖ Gₖ n/(n − p) + s² E Eᵀ) S⁻¹,    E = Gᵀ ρ″ W B

    where Cₖ is the autocovariance over time of the weighted errors of coordinate k (`autocovariance`). With independent
    errors it is the textbook's σ² S⁻¹. Errors of real keypoints last for several frames; then the covariance is larger,
    by as much as the errors resemble the effect of a parameter. The second term is for errors that are the same
    whenever a keypoint is in the same place, which more swings do not average: B has the polynomials of its position
    up to the third degree (`places`), and s is the most likely size of their coefficients (`likely_size`).

    Directions of η without curvature get no step and no covariance; the result names them.

    Args:
        dynamics: near the solution.
        free: a pytree of bools of the dynamics' shape: which leaves are θ.
        observed: observed positions at consecutive frames, image-plane units.
        u: inputs, constant or held per frame.
        dt: seconds between frames.
        initial: initial states near the solution, `[N, dim]` each.

    Raises:
        KeycldError: for another kind of law, fewer observations than unknowns, or motions that diverge.
    """
    if not isinstance(dynamics.law, ConstrainedLagrangian):
        raise KeycldError(f"error bars need a ConstrainedLagrangian, not a {type(dynamics.law).__name__}.")
    with jax.enable_x64(True):
        tracks, inputs, step = np.asarray(observed, float), jnp.asarray(np.asarray(u, float)), float(dt)
        unknowns, eta = Unknowns.of(dynamics, free, tracks)
        start = Motion(*(jnp.asarray(np.asarray(part, float)) for part in initial))
        eta, near, whiten = _minimum(unknowns, eta, start, tracks, inputs, step)
        return _with_covariance(unknowns, eta, near, tracks, whiten, step)


def derive(found: Estimate, function: Callable[..., dict[str, Array]], *arguments: Any) -> dict[str, Derived]:
    """Return numbers that depend on η with their standard errors, by the delta method.

    Args:
        found: the estimate.
        function: (law, constants of Φ, *arguments) → numbers by name, differentiable.
        arguments: what else the function needs.
    """
    with jax.enable_x64(True):
        values, slopes = _differentiated(found.unknowns, jnp.asarray(found.eta), function, arguments)
    return {name: _derived(found, float(values[name]), np.asarray(slopes[name])) for name in values}


@eqx.filter_jit
def _differentiated(unknowns: Unknowns, eta: Array, function: Callable, arguments: tuple) -> tuple[Any, Any]:
    def of(eta: Array) -> tuple[dict[str, Array], dict[str, Array]]:
        numbers = function(*unknowns.law(eta), *arguments)
        return numbers, numbers

    slopes, values = jax.jacfwd(of, has_aux=True)(eta)
    return values, slopes


def _derived(found: Estimate, value: float, slope: np.ndarray) -> Derived:
    if not (math.isfinite(value) and np.all(np.isfinite(slope))):
        return Derived(value, math.nan, False)
    scaled = slope * found.scale
    leak = np.linalg.norm(found.flat.T @ scaled)
    sigma = math.sqrt(max(0.0, float(slope @ found.covariance @ slope)))
    return Derived(value, sigma, bool(leak <= _LEAK * np.linalg.norm(scaled)))


def _minimum(
    unknowns: Unknowns, eta: np.ndarray, start: Motion, tracks: np.ndarray, u: Array, dt: float
) -> tuple[np.ndarray, Sensitivity, np.ndarray]:
    """Return the best η, the motions there, and W `[N, T, dim, dim]`.

    Errors across and along the constraints are weighed apart only near the minimum for equal weights: far from it, all
    of them are errors of the parameters.
    """
    near = sensitivity(unknowns, eta, start, u, dt, tracks.shape[1])
    whiten = np.zeros(0)
    for apart in (False, True):
        scales = None
        for _ in range(_STEPS):
            error = tracks - near.x
            if not np.all(np.isfinite(near.slopes)):
                raise KeycldError(
                    "the fitted motions diverge, so that nothing can be said of the parameters of their law."
                )
            measured, matrices = _whitening(unknowns, eta, near.x, error, apart)
            # They follow the errors as they become smaller, and then stay: a cost that changes has no minimum.
            if scales is None or np.any(measured < 0.9 * scales):
                scales, whiten = measured, matrices
            scaled = _times(whiten, error)
            normal = NormalEquations(whiten @ near.slopes, scaled, _weight(scaled), near.local)
            if normal.gain() < _DONE * (len(eta) + near.initial.x.shape[0] * near.local):
                break
            for damping in _DAMPINGS:
                moves, change = normal.step(damping)
                moved = near.moved(moves)
                x = paths(unknowns, jnp.asarray(eta + change), moved, u, jnp.asarray(dt), tracks.shape[1])
                if _cost(_times(whiten, tracks - np.asarray(x))) < _cost(scaled):
                    there = sensitivity(unknowns, eta + change, moved, u, dt, tracks.shape[1])
                    if np.all(np.isfinite(there.slopes)):
                        eta, near = eta + change, there
                        break
            else:
                break
    return eta, near, whiten


def _whitening(
    unknowns: Unknowns, eta: np.ndarray, x: np.ndarray, error: np.ndarray, apart: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return deviations, and W `[N, T, dim, dim]`: errors W e across and along the constraints have a deviation of one.

    The deviations are those of the keypoints, and those across each constraint; without `apart` the former alone.
    """
    sigma = robust_scale(error)
    unit = np.broadcast_to(np.eye(len(sigma)), (*error.shape, len(sigma)))
    rows = np.asarray(_jacobians(unknowns.law(jnp.asarray(eta))[0], jnp.asarray(x)))
    if not (apart and 0 < rows.shape[-2] < len(sigma)):
        return sigma, unit / sigma
    normals, _ = np.linalg.qr(np.swapaxes(rows * sigma, -1, -2))
    across = np.einsum("ntdj,ntd->ntj", normals, error / sigma)
    along = np.linalg.norm(error / sigma - _times(normals, across), axis=-1) / math.sqrt(len(sigma) - rows.shape[-2])
    most = deviation(along)
    each = np.array([max(deviation(across[..., j]), _THIN * most) for j in range(rows.shape[-2])])
    whiten = (unit / most + normals * (1 / each - 1 / most) @ np.swapaxes(normals, -1, -2)) / sigma
    return np.concatenate([sigma, each * np.mean(sigma)]), whiten


@eqx.filter_jit
def _jacobians(law: ConstrainedLagrangian, x: Array) -> Array:
    return jax.vmap(jax.vmap(law.jacobian))(x)


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.einsum("ntij,ntj->nti", matrices, vectors)


def _with_covariance(
    unknowns: Unknowns, eta: np.ndarray, near: Sensitivity, tracks: np.ndarray, whiten: np.ndarray, dt: float
) -> Estimate:
    error = _times(whiten, tracks - near.x)
    # The second derivative of ρ, not the weight of the steps, is the curvature of the cost.
    weight = _weight(error) ** 3
    normal = NormalEquations(whiten @ near.slopes, error, weight, near.local)
    inverse, flat, scale = normal.inverse()
    used = len(eta) - flat.shape[1] + len(tracks) * near.local
    if tracks.size <= used:
        raise KeycldError(f"{tracks.size} observed numbers do not determine {used} unknowns: use more frames.")
    share = tracks.size / (tracks.size - used)
    scores = _weight(error) * error
    covariances = [autocovariance(scores[:, :, d]) * share for d in range(tracks.shape[-1])]
    inefficiency = [(2 * each.sum() - each[0]) / max(each[0], 1e-300) for each in covariances]
    # The polynomials as further parameters: what of them the others do not imitate shows their size.
    placed = NormalEquations(whiten @ np.concatenate([near.slopes, places(near.x)], -1), error, weight, near.local)
    imitated = placed.matrix[: len(eta), len(eta) :]
    rest = placed.effect[..., len(eta) :] - normal.effect @ (inverse @ imitated)
    curvature = placed.matrix[len(eta) :, len(eta) :] - imitated.T @ inverse @ imitated
    size = likely_size(np.einsum("ntdi,ntd->i", rest, scores), _products(rest, covariances), curvature)
    uneven = size**2 * inverse @ imitated @ imitated.T @ inverse
    return Estimate(
        unknowns=unknowns,
        eta=eta,
        covariance=inverse @ _products(normal.effect, covariances) @ inverse + uneven,
        flat=flat,
        scale=scale,
        noise=robust_scale(tracks - near.x)[::2] * math.sqrt(share),
        inefficiency=np.maximum(1.0, np.array(inefficiency).reshape(-1, 2).mean(axis=1)),
        initial=near.initial,
        paths=near.x,
        dt=dt,
        uneven=uneven,
        misfit=_misfit(tracks - near.x, tracks),
    )


def _products(effect: np.ndarray, covariances: list[np.ndarray]) -> np.ndarray:
    """Return the covariance of Σ effect · error, the errors of different coordinates independent."""
    return sum(
        (lagged_products(effect[:, :, d], each) for d, each in enumerate(covariances)),
        np.zeros((effect.shape[-1], effect.shape[-1])),
    )


def _misfit(error: np.ndarray, tracks: np.ndarray) -> float:
    """Return the errors that last, as a share of the motion. Steps of independent errors have twice their variance."""
    lasting = np.mean(error**2) - np.mean(np.diff(error, axis=1) ** 2) / 2
    return math.sqrt(max(0.0, float(lasting)) / float(np.mean(np.var(tracks, axis=1))))


def _weight(error: np.ndarray) -> np.ndarray:
    """Return ρ'(e)/e = 1/√(1 + e²/25)."""
    return 1 / np.sqrt(1 + (error / _OUTLIER) ** 2)


def _cost(error: np.ndarray) -> float:
    # A step that goes too far may lead motions to infinity.
    with np.errstate(over="ignore", divide="ignore"):
        total = float(np.sum(_OUTLIER**2 * (1 / _weight(error) - 1)))
    return total if math.isfinite(total) else math.inf


class NormalEquations:
    """Weighted least squares for (zᵢ, η), the initial states zᵢ eliminated recording by recording.

    Attributes:
        inner: Jᵀ W J of the initial states `[N, m2, m2]`.
        alone: the change of the initial states while η stays `[N, m2]`.
        follow: (Jᵀ W J)⁻¹ Jᵀ W ∂x/∂η: the best initial states change by minus this `[N, m2, P]`.
        effect: G = dx/dη with the best initial states for each η `[N, T, dim, P]`.
        matrix: Gᵀ W G `[P, P]`.
    """

    def __init__(self, slopes: np.ndarray, error: np.ndarray, weight: np.ndarray, local: int):
        """Eliminate the initial states.

        Args:
            slopes: ∂x/∂(z, η) `[N, T, dim, local + P]`.
            error: observed minus x `[N, T, dim]`, both in units of σ.
            weight: of each error.
            local: numbers of each zᵢ.
        """
        by_start, by_eta = slopes[..., :local], slopes[..., local:]
        pull = by_start * weight[..., None]
        self.inner = np.einsum("ntdi,ntdj->nij", pull, by_start)
        self.follow = np.linalg.solve(self.inner, np.einsum("ntdi,ntdj->nij", pull, by_eta))
        self._pull = np.einsum("ntdi,ntd->ni", pull, error)
        self.alone = np.linalg.solve(self.inner, self._pull[..., None])[..., 0]
        self.effect = by_eta - np.einsum("ntdi,nij->ntdj", by_start, self.follow)
        weighted = self.effect * weight[..., None]
        self.matrix = np.einsum("ntdi,ntdj->ij", weighted, self.effect)
        self._slope = np.einsum("ntdi,ntd->i", weighted, error)

    def inverse(self, damping: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (Gᵀ W G)⁻¹ without flat directions, these as columns, and the scale of the parameters."""
        diagonal = np.diag(self.matrix)
        dead = diagonal <= 1e-24 * max(float(diagonal.max(initial=0.0)), 1e-300)
        scale = 1 / np.sqrt(np.where(dead, 1.0, diagonal))
        scaled = np.where(dead[:, None] | dead[None, :], 0.0, self.matrix) * scale[:, None] * scale[None, :]
        values, vectors = np.linalg.eigh(scaled)
        sound = values > _FLAT
        inner = vectors[:, sound] / (values[sound] + damping) @ vectors[:, sound].T
        return inner * scale[:, None] * scale[None, :], vectors[:, ~sound], scale

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the change of the initial states `[N, m2]` and of η."""
        change = self.inverse(damping)[0] @ self._slope
        return (self.alone - np.einsum("nij,j->ni", self.follow, change)) / (1 + damping), change

    def gain(self) -> float:
        """Return twice what a step without damping would gain of the cost."""
        return float(self._slope @ self.inverse()[0] @ self._slope + np.sum(self._pull * self.alone))
