"""Initial state and own parameters of a trajectory from the keypoints of its given frames."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from keycld.mechanics import (
    AbstractDynamics,
    ConstrainedLagrangian,
    MechanicalDynamics,
    Motion,
    Own,
    State,
    moved,
    own_law,
    own_parameters,
    rough_places,
)
from keycld.models.keycld.initial_state import TAIL, AbstractInitialState, reweighted

# Levenberg–Marquardt steps from each first guess of the place, and how many deviations the guesses are from the mean.
_STEPS, _AWAY = 25, 1.5
# Radial functions of the light, next to linear ones.
_CENTRES = 48
# Least deviation of an own number, so that the prior of one that does not differ stays regular.
_LEAST = 1e-3
_WIDTHS, _RIDGES = (0.5, 1.0, 2.0, 4.0), (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
# Least deviation of what is seen that is the unit: 10 % of the size of light, as much of its direction.
_DIM = 0.1
# Deviations of places and of the logarithms of factors in a wide prior, and of an observation next to which it is wide.
_WIDE, _EXACT = (0.3, 0.5), 1e-3
# Constants above this share of the largest one are not near 0.
_NEAR_ZERO = 0.05


class OwnPrior(eqx.Module):
    """The normal prior of a trajectory's own parameters ζ = (p, log μ, log φ), given what its given frames show.

        p ~ N(a + A x̄, Σ_p),    (log μ, log φ) ~ N(B b(l, h(Φ)), Σ_f),    Φ ~ N(c, diag σ_c²)

    x̄ is the mean of the given keypoints, l the light of the parts (`PartLight`), Φ the constants around p, such as a
    squared length: the friction factor of a hinge falls with it. h is the logarithm of constants of one sign that are
    not near 0, for laws of powers, and else the identity. b holds 1, what is seen, s = (l, h), and radial functions
    exp(−|s − s_j|²/2w²). All of it is measured on training recordings whose ζ the whole motion tells (`measured`), not
    trained. So a parameter that can be seen, such as a mass that makes a disc larger, has a narrow prior; one that does
    not differ keeps a deviation of nothing.

    Attributes:
        shift: a [2].
        turn: A [2, 2].
        place_root: a root of Σ_p [2, 2].
        powers: whether h is the logarithm [n], 1 or 0.
        seen_mean: mean of s [F], F = 4K + n.
        seen_scale: its deviation [F], 0.1 at least.
        centres: s_j [C, F], in units of that deviation.
        width: w.
        factors: B [K + 1, 1 + F + C].
        factor_root: a root of Σ_f [K + 1, K + 1].
        constants: c [n].
        spread: σ_c [n].
    """

    shift: Float[Array, "2"]
    turn: Float[Array, "2 2"]
    place_root: Float[Array, "2 2"]
    powers: Float[Array, "n"]
    seen_mean: Float[Array, "F"]
    seen_scale: Float[Array, "F"]
    centres: Float[Array, "C F"]
    width: Float[Array, ""]
    factors: Float[Array, "L B"]
    factor_root: Float[Array, "L L"]
    constants: Float[Array, "n"]
    spread: Float[Array, "n"]

    @classmethod
    def unknown(cls, keypoints: int, constants: int) -> "OwnPrior":
        """Return a wide prior, before it is measured."""
        size = 4 * keypoints + constants
        return cls(
            shift=jnp.zeros(2),
            turn=jnp.eye(2),
            place_root=0.3 * jnp.eye(2),
            powers=jnp.zeros(constants),
            seen_mean=jnp.zeros(size),
            seen_scale=jnp.ones(size),
            centres=jnp.zeros((_CENTRES, size)),
            width=jnp.ones(()),
            factors=jnp.zeros((keypoints + 1, 1 + size + _CENTRES)),
            factor_root=0.5 * jnp.eye(keypoints + 1),
            constants=jnp.zeros(constants),
            spread=jnp.ones(constants),
        )

    def expected_place(self, x: Float[Array, "n dim"]) -> Float[Array, "2"]:
        """Return the mean of p for the keypoints of the given frames."""
        return self.shift + jnp.sum(self.turn * jnp.mean(x.reshape(-1, 2), axis=0)[None], axis=1)

    def expected_factors(self, light: Float[Array, "K 4"] | None, constants: Float[Array, "n"]) -> Float[Array, "L"]:
        """Return the mean of (log μ, log φ).

        Args:
            light: of the parts, mean over the given frames; None: unknown.
            constants: Φ(x − p).
        """
        known = self.seen_mean[: len(self.seen_mean) - len(constants)] if light is None else light.reshape(-1)
        seen = jnp.concatenate([known, _sizes(constants, self.powers)])
        values = _functions((seen - self.seen_mean) / self.seen_scale, self.centres, self.width)
        return jnp.sum(self.factors * values[None], axis=1)

    @classmethod
    def measured(
        cls,
        own: Float[np.ndarray, "N S"],
        x: Float[np.ndarray, "N n dim"],
        light: Float[np.ndarray, "N F"],
        constants: Float[np.ndarray, "N c"],
    ) -> "OwnPrior":
        """Return the prior that recordings show.

        Width and ridge of the radial functions are those with the least error on recordings left out, one at a time.

        Args:
            own: ζ of each recording.
            x: keypoints of a few consecutive frames of each.
            light: mean light in these frames.
            constants: values of Φ of each.
        """
        middle = np.concatenate([np.ones((len(x), 1)), x.reshape(len(x), -1, 2).mean(axis=1)], axis=1)
        affine = np.linalg.lstsq(middle, own[:, :2], rcond=None)[0]
        size = np.abs(constants)
        powers = (size.min(axis=0) > _NEAR_ZERO * size.max(axis=0)) & (np.ptp(np.sign(constants), axis=0) == 0)
        shown = np.concatenate([light, np.asarray(_sizes(constants, powers))], axis=1)
        mean, scale = shown.mean(axis=0), np.maximum(shown.std(axis=0), _DIM)
        seen = (shown - mean) / scale
        centres = seen[_apart(seen, _CENTRES)]
        best: tuple[float, Any] = (np.inf, None)
        for width in _WIDTHS:
            values = np.stack([np.asarray(_functions(each, centres, width)) for each in seen])
            for ridge in _RIDGES:
                fitted, left_out = _ridge(values, own[:, 2:], ridge)
                # The largest part of a mean would be a number that cannot be seen, and decide how well others are.
                error = float(np.sum(np.log(np.mean(left_out**2, axis=0) + _LEAST**2)))
                if error < best[0]:
                    best = error, (width, fitted, left_out)
        width, fitted, left_out = best[1]
        arrays = (
            affine[0],
            affine[1:].T,
            _root(own[:, :2] - middle @ affine),
            powers,
            mean,
            scale,
            centres,
            width,
            fitted.T,
            _root(left_out),
            constants.mean(axis=0),
            constants.std(axis=0) + _LEAST,
        )
        return cls(*(jnp.asarray(array, jnp.float32) for array in arrays))


class OwnInitialState(AbstractInitialState):
    """State at frame 0 and own parameters ζ, fitted through the dynamics to the keypoints of the given frames.

    Levenberg–Marquardt steps minimise

        Σ_tk ρ(|x_k(t; x_0, v_0, ζ) − x̂_tk| / σ_k) + ½ |ζ − ζ̄|²_Σ + ½ |(Φ − c) / σ_c|²,
        ρ(e) = (ν + 2)/2 log(1 + e²/ν),    ν = 4

    with the prior of ζ and Φ (`OwnPrior`). Φ is the mean over the given frames. Five frames bend so little that two
    places, on either side of the path, may explain them: the steps begin at several places, and the best end counts.

    Attributes:
        prior: of ζ.
        error: σ [K] of the two coordinates of each observed keypoint, image-plane units; measured, not trained.
    """

    prior: OwnPrior
    error: Float[Array, " K"]

    @property
    def given(self) -> int:
        """Two: fewer frames have no velocity."""
        return 2

    @property
    def anchor(self) -> int:
        """The first frame."""
        return 0

    @property
    def shared(self) -> None:
        """None: each trajectory has its own constants."""

    def __call__(
        self, dynamics: AbstractDynamics, x: Float[Array, "given dim"], dt: Float[Array, ""], u: Float[Array, "..."]
    ) -> State:
        """Return the state at frame 0, for unknown light."""
        return self.smooth(dynamics, x, dt, u)[0]

    def smooth(
        self,
        dynamics: AbstractDynamics,
        x: Float[Array, "n dim"],
        dt: Float[Array, ""],
        u: Float[Array, "..."],
        light: Float[Array, "K 4"] | None = None,
    ) -> tuple[State, None]:
        """Return the state at frame 0 from all frames."""
        return self.searched(dynamics, x, dt, u, light)[0], None

    def searched(
        self,
        dynamics: AbstractDynamics,
        x: Float[Array, "n dim"],
        dt: Float[Array, ""],
        u: Float[Array, "..."],
        light: Float[Array, "K 4"] | None = None,
    ) -> tuple[State, Float[Array, ""]]:
        """Return the state at frame 0 from all frames, and the least sum, which tells how likely it is."""
        assert isinstance(dynamics, MechanicalDynamics) and isinstance(dynamics.law, ConstrainedLagrangian)
        (count, dim), law = x.shape, dynamics.law
        prior, phi = self.prior, law.constraint_function
        place, others = prior.expected_place(x), jnp.zeros(len(prior.factor_root))
        clock, inputs = dt * (count - 1) / 2, u if u.ndim == 1 else u[: count - 1]

        def state(z: Array) -> State:
            there = place + jnp.matmul(prior.place_root, z[2 * dim : 2 * dim + 2], precision="highest")
            constants = jnp.mean(jax.vmap(phi)(moved(x, there)), axis=0)
            factors = jnp.matmul(prior.factor_root, z[2 * dim + 2 :], precision="highest")
            own = own_parameters(jnp.concatenate([there, prior.expected_factors(light, constants) + factors]))
            here = own_law(law, own)
            position = here.project_position(z[:dim], constants)
            velocity = here.project_velocity(position, z[dim : 2 * dim] / clock)
            return State(Motion(position, velocity), {"constants": constants, **own})

        def residuals(z: Array) -> tuple[Array, Array]:
            first = state(z)
            off = (dynamics.rollout(first, inputs, dt, count - 1).x - x).reshape(count, -1, 2)
            unexpected = (first.parameters["constants"] - prior.constants) / prior.spread
            return off / self.error[None, :, None], jnp.concatenate([z[2 * dim :], unexpected])

        def cost(z: Array) -> Array:
            off, unexpected = residuals(z)
            total = (TAIL + 2) / 2 * jnp.sum(jnp.log1p(jnp.sum(off**2, axis=2) / TAIL)) + jnp.sum(unexpected**2) / 2
            return jnp.where(jnp.isfinite(total), total, jnp.inf)

        def improve(search: tuple[Array, Array, Array], _: None) -> tuple[tuple[Array, Array, Array], None]:
            z, least, damping = search
            (off, unexpected), (by_off, by_unexpected) = residuals(z), jax.jacfwd(residuals)(z)
            normal, slope = reweighted(off, by_off)
            normal = normal + jnp.matmul(by_unexpected.T, by_unexpected, precision="highest")
            slope = slope + jnp.matmul(by_unexpected.T, unexpected, precision="highest")
            diagonal = jnp.diagonal(normal)
            # The projections remove some directions of position and velocity; this keeps the matrix regular there. The
            # others have a prior, and next to precise keypoints so much damping would stop them.
            floor = jnp.where(jnp.arange(len(z)) < 2 * dim, 1e-6 * jnp.max(diagonal), 0.0)
            step = jnp.linalg.solve(normal + jnp.diag(damping * diagonal + floor), slope)
            there = cost(z - step)
            better = there < least
            damping = jnp.where(better, jnp.maximum(damping / 5, 1e-6), jnp.minimum(damping * 8, 1e4))
            return (jnp.where(better, z - step, z), jnp.where(better, there, least), damping), None

        def search(away: Array) -> tuple[Array, Array]:
            z = jnp.concatenate([x[0], clock * (x[1] - x[0]) / dt, away, others])
            (z, least, _), _ = jax.lax.scan(improve, (z, cost(z), jnp.asarray(1e-2)), length=_STEPS)
            return z, least

        guesses = _AWAY * jnp.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        ends, costs = jax.vmap(search)(guesses)
        best = jnp.argmin(costs)
        return state(ends[best]), costs[best]


def own_guess(model: Any, x: jax.Array) -> Own | None:
    """Return a first guess and a wide prior of the own parameters in keypoints `[N, T, 2K]`; None without any."""
    if not isinstance(model.initial_state, OwnInitialState):
        return None
    numbers = jnp.concatenate(
        [rough_places(model.law, x), jnp.zeros((len(x), len(model.initial_state.prior.factors)))], axis=1
    )
    spread = jnp.where(jnp.arange(numbers.shape[1]) < 2, *_WIDE)
    return Own(numbers, numbers, jnp.diag((_EXACT / spread) ** 2))


def _sizes(constants: Any, powers: Any) -> Array:
    """Return h: the logarithm of the constants that `powers` names, the others as they are."""
    return jnp.where(powers, jnp.log(jnp.maximum(jnp.abs(constants), 1e-6)), constants)


def _functions(seen: Any, centres: Any, width: Any) -> Array:
    """Return b: 1, the looks `[F]`, and the radial functions around `[C, F]`."""
    near = jnp.exp(-jnp.sum((jnp.asarray(seen)[None] - centres) ** 2, axis=1) / (2 * width**2))
    return jnp.concatenate([jnp.ones(1), jnp.asarray(seen), near])


def _apart(points: np.ndarray, count: int) -> list[int]:
    """Return which points are far apart from each other: each next one is the farthest from those before."""
    chosen, distance = [0], np.sum((points - points[0]) ** 2, axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.sum((points - points[chosen[-1]]) ** 2, axis=1))
    return chosen


def _ridge(values: np.ndarray, target: np.ndarray, ridge: float) -> tuple[np.ndarray, np.ndarray]:
    """Return weights `[B, L]`, and the errors on points left out one at a time; the first function has no ridge."""
    penalty = ridge * np.eye(values.shape[1])
    penalty[0, 0] = 1e-9
    inverse = np.linalg.solve(values.T @ values + penalty, values.T)
    fitted = inverse @ target
    leverage = np.einsum("nb,bn->n", values, inverse)
    return fitted, (target - values @ fitted) / np.maximum(1 - leverage, 0.05)[:, None]


def _root(errors: np.ndarray) -> np.ndarray:
    """Return a root of the covariance of errors `[N, m]` around 0."""
    return np.linalg.cholesky(errors.T @ errors / len(errors) + _LEAST**2 * np.eye(errors.shape[1]))
