"""SyMetric: whether a latent vector is a canonical transformation of the true state."""

import warnings
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from keycld._errors import KeycldError
from keycld.models.base import AbstractModel, HasPosterior

if TYPE_CHECKING:
    from keycld.data import DataSet

_DEGREES, _MOST_FEATURES = 5, 1000
_ENOUGH, _SYMPLECTIC = 0.9, 0.05
_STRENGTHS = np.logspace(-4, -0.5, 10)
_SMALL, _SHIFT, _CAP = 1e-3, 1e-6, 1000.0
_POINTS = 10
_TRAJECTORIES, _FRAMES = 5, 60


class SyMetric(NamedTuple):
    """What `symetric` finds.

    Attributes:
        passed: the score itself: R² > 0.9 and `asymmetry` < 0.05.
        r2: how well polynomials of the latent vector explain the true state.
        asymmetry: mean (P − I)², 0 for a canonical transformation, 1000 where there is none.
        degree: of the polynomials.
        informative: how many numbers of the latent vector are used.
    """

    passed: bool
    r2: float
    asymmetry: float
    degree: int
    informative: int


def symetric(
    truth: Float[np.ndarray, "N T d"],
    latent: Float[np.ndarray, "N T D"],
    informative: Bool[np.ndarray, "D"] | None = None,
    *,
    seed: int = 0,
) -> SyMetric:
    """Score how canonical the map from latent vectors z to true states x is.

    Both hold positions, then momenta, and are standardised. Polynomials x = f(z) of degree 1, 2, … ≤ 5 are fitted by
    Lasso, its strength chosen by two-fold cross-validation, until R² ≥ 0.9. With J = ∂f/∂z at ten random frames of each
    trajectory and E = [[0, −1], [1, 0]],

        P = (J E Jᵀ) (J Eᵀ Jᵀ),    asymmetry = mean (P / mean max|P| − 1)²

    where the mean of max|P| is over the frames of the trajectory. If z is canonical up to a factor, J E Jᵀ ∝ E, so P is
    a multiple of the identity. (So it is if positions and momenta are exchanged at random; the score cannot see that.)

    Args:
        truth: true states along trajectories.
        latent: latent vectors of the same frames.
        informative: which of them say something, by default all; q and p of a pair stay together.
        seed: of the frames.

    Raises:
        KeycldError: scikit-learn is not installed.

    Source: Higgins et al., "SyMetric", as the code of "Which priors matter?" computes it. There a degree is tried for
    400 seconds; here while it has 1,000 monomials at most.
    """
    try:
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.linear_model import Lasso
        from sklearn.model_selection import GridSearchCV
        from sklearn.preprocessing import PolynomialFeatures
    except ImportError:
        raise KeycldError("SyMetric needs scikit-learn: pip install 'keycld[symetric]'.") from None
    chosen = _pairs(informative, latent.shape[2])
    size = int(np.sum(chosen))
    if size < 2:
        return SyMetric(False, 0.0, _CAP, 0, size)
    x, z = (_standardised(each.reshape(-1, each.shape[2])) for each in (truth, latent[:, :, chosen]))
    best: Any = None
    for degree in range(1, _DEGREES + 1):
        monomials = PolynomialFeatures(degree, include_bias=False).fit(z)
        if degree > 1 and monomials.n_output_features_ > _MOST_FEATURES:
            break
        search = GridSearchCV(Lasso(max_iter=1000), {"alpha": _STRENGTHS}, scoring="explained_variance", cv=2)
        features = monomials.transform(z)
        with warnings.catch_warnings():
            # Weak strengths need more iterations than the paper's; cross-validation judges what they reach.
            warnings.simplefilter("ignore", ConvergenceWarning)
            search.fit(features, x)
        best = degree, monomials.powers_, np.atleast_2d(search.best_estimator_.coef_), search.score(features, x)
        if best[3] >= _ENOUGH:
            break
    degree, powers, weights, r2 = best
    weights = np.where(np.abs(weights) > _SMALL, weights, 0.0)
    random, scores = np.random.default_rng(seed), []
    for along in z.reshape(*latent.shape[:2], size):
        frames = random.choice(len(along), min(_POINTS, len(along)), replace=False)
        products = np.stack([_product(_jacobian(weights, powers, each)) for each in along[frames]])
        scale = np.mean(np.max(np.abs(products), axis=(1, 2)))
        scores.append(np.mean((products / scale - np.eye(len(weights))[None]) ** 2))
    asymmetry = min(float(np.mean(scores)), _CAP)
    return SyMetric(bool(r2 > _ENOUGH and asymmetry < _SYMPLECTIC), float(r2), asymmetry, degree, size)


def score_symetric(model: AbstractModel, data: "DataSet", *, batches: int = 20) -> list[SyMetric]:
    """Return the scores of batches of five test trajectories, 60 frames of each.

    Latent vectors are the states of a roll-out from the given frames, from the frame of the first state on. They are
    informative where the variance of the posterior, mean over the batch, is below 1/2.

    Args:
        model: any model.
        data: with a test set that knows the true states.
        batches: how many, as far as there are trajectories.

    Raises:
        KeycldError: there are fewer than five test trajectories, or they are shorter than 60 frames; they have no
            true states; scikit-learn is not installed.
    """
    count = min(batches, data.count("test") // _TRAJECTORIES)
    test = data.split("test", rows=slice(0, _TRAJECTORIES * count))
    if not count or test.frames < _FRAMES:
        raise KeycldError(
            f"SyMetric takes {_TRAJECTORIES} test trajectories of {_FRAMES} frames; {data.folder} has "
            f"{data.count('test')}: make more or longer ones."
        )
    if test.state is None:
        raise KeycldError(
            f"SyMetric compares with true states, but test.h5 of {data.folder} has no '/state': add it, or choose data "
            "that have it."
        )
    assert test.image is not None
    anchor = model.anchor(model.context)
    found = []
    for first in range(0, len(test.input), _TRAJECTORIES):
        rows = slice(first, first + _TRAJECTORIES)
        given = jnp.asarray(np.asarray(test.image[rows, : model.context]), jnp.float32) / 255.0
        latent, variance = _latent(model, given, jnp.asarray(test.dt, jnp.float32), jnp.asarray(test.input[rows]))
        informative = None if variance is None else np.asarray(variance) < 0.5
        if informative is not None and len(informative) != latent.shape[2]:
            informative = None
        found.append(symetric(test.state[rows, anchor:_FRAMES], np.asarray(latent, float), informative, seed=first))
    return found


@eqx.filter_jit
def _latent(model: AbstractModel, given: Array, dt: Array, u: Array) -> tuple[Array, Array | None]:
    """Return the states along roll-outs as vectors `[N, T, D]`, and the mean variance of the posterior `[D]`."""

    def one(frames: Array, u: Array) -> Array:
        inputs = u if u.ndim == 1 else u[: _FRAMES - 1]
        anchor = model.anchor(model.context)
        states = model.rollout(
            model.infer(frames, dt, inputs), dt, inputs if u.ndim == 1 else inputs[anchor:], _FRAMES - 1 - anchor
        )
        return jnp.concatenate(
            [leaf.reshape(leaf.shape[0], -1) for leaf in jax.tree.leaves(states.coordinates)], axis=1
        )

    variance = None
    if isinstance(model, HasPosterior):
        variance = jnp.mean(jax.vmap(model.posterior)(given).deviation ** 2, axis=0)
    return jax.vmap(one)(given, u), variance


def _pairs(informative: np.ndarray | None, count: int) -> np.ndarray:
    """Return which numbers are used: pairs of which one at least is informative; all, if none is."""
    if informative is None or not np.any(informative):
        return np.ones(count, bool)
    return np.tile(np.any(informative.reshape(2, -1), axis=0), 2)


def _standardised(values: np.ndarray) -> np.ndarray:
    """Return columns of mean 0 and deviation 1; constant ones become 0."""
    deviation = np.std(values, axis=0)
    return (values - np.mean(values, axis=0)) / np.where(deviation > 0, deviation, np.inf)


def _jacobian(weights: np.ndarray, powers: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return ∂x/∂z `[d, D]` of x = Σ weights · Π z^powers."""
    columns = []
    for k, each in enumerate(powers.T):
        lowered = powers.copy()
        lowered[:, k] = np.maximum(each - 1, 0)
        columns.append(weights @ (each * np.prod(z[None] ** lowered, axis=1)))
    return np.stack(columns, axis=1) + _SHIFT


def _product(jacobian: np.ndarray) -> np.ndarray:
    half = jacobian.shape[1] // 2
    e = np.block([[np.zeros((half, half)), -np.eye(half)], [np.eye(half), np.zeros((half, half))]])
    return (jacobian @ e @ jacobian.T) @ (jacobian @ e.T @ jacobian.T)
