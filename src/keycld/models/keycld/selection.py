"""Selection of the terms of V and R that a motion asks for, from the curvature of a fit with all of them."""

import dataclasses
from collections.abc import Mapping, Set
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from keycld.mechanics import (
    AbstractDissipationTerm,
    AbstractPotentialTerm,
    AbstractTerm,
    ConstrainedLagrangian,
    Fitted,
    MechanicalDynamics,
    Own,
    moved,
    term_kinds,
    terms_of,
    with_terms,
)
from keycld.models.keycld.law_fit import fit_law, free_leaves, lagrangian, owner_of, with_law
from keycld.models.keycld.tracks import Tracks

# A term stays if without it the cost of the fit would rise by this share.
WORTH = 0.2
# The same for energies other than that of springs, in short clips.
_FURTHER = 0.5
# What a mechanism has before other forces are suspected.
PLAIN = ("springs", "viscous")
# Share by which masses may follow when a term is dropped, for that same cost.
_FOLLOW = 0.2
# The least stiffness of a mass, as a share of its curvature. Below the softness that counts, it would be none at all.
_STIFF = 1e-5
# Directions of θ are idle below this share of the largest change of the accelerations, at so many states. Rounding
# leaves 5e-8 of idle ones; the weakest others have 2e-4, in the motion of two bodies.
_IDLE, _STATES = 1e-6, 200


@dataclasses.dataclass(frozen=True)
class Tried:
    """Which forces `identify` tries.

    Attributes:
        kinds: of the terms; None: all but the last resort.
        worth: a term stays if without it the cost of the fit would rise by this share.
        takes: each friction must take energy next to the others too, not only in their place; and other forces must
            explain more than springs and viscous friction do, energies by half of the cost. On clips of a cart and of
            a ball on a spring a fixed point that pulls was worth 10 to 25 %, by small errors of the keypoint that
            return with the place, and made periods 1 and 1.7 % wrong.
        located: pivots that the positions determine alone, because they span 1.5 rad, are not fitted with the dynamics.
            A real mechanism deviates from every law by more than from its circle, and would pull the pivot away.
    """

    kinds: tuple[str, ...] | None = None
    worth: float = WORTH
    takes: bool = False
    located: bool = False

    @property
    def named(self) -> tuple[str, ...]:
        """Kinds of the terms, also where `kinds` is None."""
        kinds = term_kinds().items()
        return tuple(kind for kind, term in kinds if (term.tried if self.kinds is None else kind in self.kinds))

    def needed(self, kind: str) -> float:
        """Return the share by which the cost must rise without a term of this kind."""
        further = kind not in PLAIN and issubclass(term_kinds()[kind], AbstractPotentialTerm)
        return max(self.worth, _FURTHER) if self.takes and further else self.worth


def select_terms(fitted: Fitted, tracks: Tracks, tried: Tried) -> tuple[MechanicalDynamics, dict[str, float]]:
    """Return the dynamics with the terms that are worth their parameters alone, and the worth of all terms.

    Its parameters have taken over what they can. A dissipation that gives energy on average, in place of all others, is
    worth nothing: next to each other, two of them may have opposite signs, unless `tried.takes`.
    """
    fitted = _with_own_held(fitted, tracks)
    paths = fitted.paths if fitted.own is None else jax.vmap(moved)(fitted.paths, fitted.own[:, :2])
    near = np.flatnonzero(fitted.followed)
    paths, tracks = paths[near], tracks[near]
    kinds = terms_of(lagrangian(fitted.dynamics))
    parameters, rest = eqx.partition(fitted.dynamics, free_leaves(fitted.dynamics))
    numbers = _Numbers.of(parameters, kinds)
    unscaled, unravel = ravel_pytree(parameters)
    slopes = _accelerations_by(fitted, paths, tracks)
    cost, scale = _quadratic(fitted, np.asarray(unscaled, float), numbers.mass, slopes)

    def dynamics(theta: np.ndarray) -> MechanicalDynamics:
        return eqx.combine(unravel(jnp.asarray(theta / scale, jnp.float32)), rest)

    kept, worth = set(kinds), {}
    dissipations = {kind for kind, term in kinds.items() if isinstance(term, AbstractDissipationTerm)}
    for kind in sorted(kinds, key=lambda kind: kinds[kind].rank, reverse=True):
        group, others = numbers.acting({kind}), numbers.following(kept - {kind})
        gives = False
        if kind in dissipations:
            rivals = numbers.acting((kept & dissipations) - {kind})
            alone = cost.without(rivals, numbers.following((kept - dissipations) | {kind}))
            laws = [alone, cost] if tried.takes else [alone]
            gives = any(float(_power(lagrangian(dynamics(law.theta)), kind, paths, tracks.dt)) <= 0 for law in laws)
        worth[kind] = 0.0 if gives else cost.rise(group, others) / float(fitted.cost)
        if worth[kind] < tried.needed(kind):
            kept.remove(kind)
            # What the others take over.
            cost = cost.without(group, others)
    left = dynamics(cost.theta)
    terms = {kind: term for kind, term in terms_of(lagrangian(left)).items() if kind in kept}
    return with_law(left, with_terms(lagrangian(left), terms)), worth


class _Numbers(NamedTuple):
    """What the free numbers of dynamics are, `[P]` each.

    Attributes:
        owner: kind of the term that has the number; None: no term has.
        linear: whether V or R is linear in it: without the term these are zero.
        mass: whether it is one of the mass matrix.
    """

    owner: np.ndarray
    linear: np.ndarray
    mass: np.ndarray

    @classmethod
    def of(cls, parameters: Any, kinds: Mapping[str, AbstractTerm]) -> "_Numbers":
        """Return what the leaves of dynamics are, in the order of `ravel_pytree`."""
        owner, linear, mass = [], [], []
        for path, leaf in jax.tree_util.tree_leaves_with_path(parameters):
            name, kind = jax.tree_util.keystr(path), owner_of(path, kinds)
            owner += [kind] * leaf.size
            linear += [kind is None or name.rsplit(".", 1)[-1] not in kinds[kind].nonlinear] * leaf.size
            mass += [".mass." in name] * leaf.size
        return cls(np.array(owner, object), np.array(linear), np.array(mass))

    def acting(self, kinds: Set[str]) -> np.ndarray:
        """Return which numbers are zero without terms of these kinds."""
        return self.linear & np.array([owner in kinds for owner in self.owner])

    def following(self, kinds: Set[str]) -> np.ndarray:
        """Return which numbers may change while only terms of these kinds act."""
        return np.array([owner is None or owner in kinds for owner in self.owner])


class _Quadratic(NamedTuple):
    """The cost of a fit near its minimum: ½ δᵀ H δ more at θ + δ.

    Attributes:
        curvature: H, `[P, P]`.
        theta: θ, `[P]`.
    """

    curvature: np.ndarray
    theta: np.ndarray

    def rise(self, group: np.ndarray, others: np.ndarray) -> float:
        """Return by how much the cost rises if a group of parameters becomes zero and the others follow."""
        mixed = self.curvature[np.ix_(group, others)]
        schur = self.curvature[np.ix_(group, group)] - mixed @ self._softness(others) @ mixed.T
        return max(0.0, 0.5 * float(self.theta[group] @ schur @ self.theta[group]))

    def without(self, group: np.ndarray, others: np.ndarray) -> "_Quadratic":
        """Return the same cost at the θ where a group is zero and the others have followed."""
        theta = self.theta.copy()
        theta[others] += self._softness(others) @ self.curvature[np.ix_(others, group)] @ theta[group]
        theta[group] = 0.0
        return self._replace(theta=theta)

    def _softness(self, some: np.ndarray) -> np.ndarray:
        return np.linalg.pinv(self.curvature[np.ix_(some, some)], rcond=1e-6, hermitian=True)


def _quadratic(
    fitted: Fitted, theta: np.ndarray, mass: np.ndarray, slopes: np.ndarray
) -> tuple[_Quadratic, np.ndarray]:
    """Return the cost of a fit in parameters of equal curvature, θ times the scale, and the scale `[P]`.

    Directions in which no acceleration changes, such as a common factor of masses and forces, have no curvature. What
    rounding leaves there is removed: next to errors of a thousandth of the motion it would decide on the terms.

    Masses follow by about a fifth only: with no mass at all any force could be missing, and where forces act between
    keypoints alone, such as attraction, this is true of their relative motion for each total mass.

    Args:
        fitted: the fit.
        theta: its θ.
        mass: which numbers are those of masses.
        slopes: derivatives of accelerations by θ, `[M, P]`.
    """
    curvature = np.asarray(fitted.curvature, float)
    scale = _scale(curvature)
    squares, directions = np.linalg.eigh((slopes / scale).T @ (slopes / scale))
    idle = directions[:, squares < _IDLE**2 * squares.max()]
    onto = np.eye(len(theta)) - idle @ idle.T
    cleaned = scale[:, None] * (onto @ (curvature / scale[:, None] / scale) @ onto) * scale
    step = _FOLLOW * np.sqrt(np.mean(theta[mass] ** 2))
    stiff = np.maximum(2 * WORTH * float(fitted.cost) / step**2, _STIFF * np.diag(curvature))
    held = cleaned + np.diag(np.where(mass, stiff, 0.0))
    scale = _scale(held)
    return _Quadratic(held / scale[:, None] / scale, theta * scale), scale


def _scale(curvature: np.ndarray) -> np.ndarray:
    """Return the factors of θ with which all parameters have a curvature of one."""
    return np.sqrt(np.maximum(np.diag(curvature), 1e-12 * np.diag(curvature).max()))


def _accelerations_by(fitted: Fitted, paths: jax.Array, tracks: Tracks) -> np.ndarray:
    """Return the derivatives of accelerations along motions by the free numbers of the dynamics, `[M, P]`."""
    x, v = _moving(paths, tracks.dt)
    u = tracks.u[:, None] if tracks.u.ndim == 2 else tracks.u[:, 1 : paths.shape[1] - 1]
    u = jnp.broadcast_to(u, (*x.shape[:2], u.shape[-1]))
    count = x.shape[0] * x.shape[1]
    x, v, u = (part.reshape(count, part.shape[-1])[:: -(-count // _STATES)] for part in (x, v, u))
    slopes = np.asarray(_slopes(fitted.dynamics, x, v, u), float)
    slopes = slopes.reshape(-1, slopes.shape[-1])
    return slopes[np.all(np.isfinite(slopes), axis=1)]


@eqx.filter_jit
def _slopes(dynamics: MechanicalDynamics, x: jax.Array, v: jax.Array, u: jax.Array) -> jax.Array:
    parameters, rest = eqx.partition(dynamics, free_leaves(dynamics))
    theta, unravel = ravel_pytree(parameters)

    def acceleration(theta: jax.Array, x: jax.Array, v: jax.Array, u: jax.Array) -> jax.Array:
        return lagrangian(eqx.combine(unravel(theta), rest)).acceleration(x, v, u)

    return jax.vmap(lambda x, v, u: jax.jacrev(acceleration)(theta, x, v, u))(x, v, u)


def _moving(paths: jax.Array, dt: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return positions and velocities `[N, T − 2, 2K]` of motions between their ends."""
    return paths[:, 1:-1], (paths[:, 2:] - paths[:, :-2]) / (2 * dt)


def _with_own_held(fitted: Fitted, tracks: Tracks) -> Fitted:
    """Return the fit with a curvature for which factors of masses and friction follow by about a fifth only.

    They would take the place of any common factor of V or R.
    """
    if tracks.own is None or fitted.own is None:
        return fitted
    stiff = 2 * WORTH * fitted.cost / (len(fitted.own) * _FOLLOW**2)
    factors = jnp.arange(len(tracks.own.precision)) >= 2
    own = Own(fitted.own, fitted.own, tracks.own.precision + jnp.diag(jnp.where(factors, stiff, 0.0)))
    held = fit_law(fitted.dynamics, dataclasses.replace(tracks, own=own), fitted, iterations=0)
    return fitted._replace(curvature=held.curvature)


@eqx.filter_jit
def _power(law: ConstrainedLagrangian, kind: str, paths: jax.Array, dt: jax.Array) -> jax.Array:
    """Return the mean power v·∂R/∂v that a dissipation of this kind takes from motions `[N, T, 2K]`."""
    term = terms_of(law)[kind]
    assert isinstance(term, AbstractDissipationTerm)
    x, v = (part.reshape(-1, paths.shape[-1]) for part in _moving(paths, dt))
    return jnp.mean(jnp.sum(v * jax.vmap(jax.grad(term, argnums=1))(x, v), axis=1))
