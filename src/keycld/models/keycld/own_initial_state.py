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
    State,
    own_law,
    own_parameters,
)
from keycld.models.keycld.initial_state import TAIL, AbstractInitialState, reweighted
from keycld.vision import image_grid

# Levenberg–Marquardt steps from each first guess of the place, and how many deviations the guesses are from the mean.
_STEPS, _AWAY = 25, 1.5
# Radial functions of the light, next to linear ones, and s of its shares.
_CENTRES, _REACH = 48, 0.1
# Less light than this, per cent of a white picture, has no direction.
_DARK = 1e-4
# Least deviation of an own number, so that the prior of one that does not differ stays regular.
_LEAST = 1e-3
_WIDTHS, _RIDGES = (0.5, 1.0, 2.0, 4.0), (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
# Least deviation of the light that is the unit: 10 % of its size, as much of its direction.
_DIM = 0.1


class OwnPrior(eqx.Module):
    """The normal prior of a trajectory's own parameters ζ = (p, log μ, log φ), given what its given frames show.

        p ~ N(a + A x̄, Σ_p),    (log μ, log φ) ~ N(B b(l), Σ_f),    Φ ~ N(c, diag σ_c²)

    x̄ is the mean of the given keypoints, l the light of the parts (`light_of`): b(l) holds 1, l, and radial functions
    exp(−|l − l_j|²/2w²). All of it is measured on training recordings whose ζ the whole motion tells (`measured`), not
    trained. So a parameter that can be seen, such as a mass that makes a disc larger, has a narrow prior; one that does
    not differ keeps a deviation of nothing.

    Attributes:
        shift: a [2].
        turn: A [2, 2].
        place_root: a root of Σ_p [2, 2].
        light_mean: mean of the light [F], F = 4K.
        light_scale: its deviation [F], 0.1 at least.
        centres: l_j [C, F], in units of that deviation.
        width: w.
        factors: B [K + 1, 1 + F + C].
        factor_root: a root of Σ_f [K + 1, K + 1].
        constants: c [n].
        spread: σ_c [n].
    """

    shift: Float[Array, "2"]
    turn: Float[Array, "2 2"]
    place_root: Float[Array, "2 2"]
    light_mean: Float[Array, "F"]
    light_scale: Float[Array, "F"]
    centres: Float[Array, "C F"]
    width: Float[Array, ""]
    factors: Float[Array, "L B"]
    factor_root: Float[Array, "L L"]
    constants: Float[Array, "n"]
    spread: Float[Array, "n"]

    @classmethod
    def unknown(cls, keypoints: int, constants: int) -> "OwnPrior":
        """Return a wide prior, before it is measured."""
        size = 4 * keypoints
        return cls(
            shift=jnp.zeros(2),
            turn=jnp.eye(2),
            place_root=0.3 * jnp.eye(2),
            light_mean=jnp.zeros(size),
            light_scale=jnp.ones(size),
            centres=jnp.zeros((_CENTRES, size)),
            width=jnp.ones(()),
            factors=jnp.zeros((keypoints + 1, 1 + size + _CENTRES)),
            factor_root=0.5 * jnp.eye(keypoints + 1),
            constants=jnp.zeros(constants),
            spread=jnp.ones(constants),
        )

    def __call__(
        self, x: Float[Array, "n dim"], light: Float[Array, "K 4"] | None
    ) -> tuple[Float[Array, "S"], Float[Array, "S S"]]:
        """Return mean of ζ and a root of its covariance.

        Args:
            x: keypoints of the given frames.
            light: of the parts, mean over these frames; None: unknown.
        """
        seen = self.light_mean if light is None else light.reshape(-1)
        values = _functions((seen - self.light_mean) / self.light_scale, self.centres, self.width)
        place = self.shift + jnp.sum(self.turn * jnp.mean(x.reshape(-1, 2), axis=0)[None], axis=1)
        factors = jnp.sum(self.factors * values[None], axis=1)
        return jnp.concatenate([place, factors]), jax.scipy.linalg.block_diag(self.place_root, self.factor_root)

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
        mean, scale = light.mean(axis=0), np.maximum(light.std(axis=0), _DIM)
        seen = (light - mean) / scale
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
        assert isinstance(dynamics, MechanicalDynamics) and isinstance(dynamics.law, ConstrainedLagrangian)
        (count, dim), law = x.shape, dynamics.law
        expected, root = self.prior(x, light)
        clock, inputs = dt * (count - 1) / 2, u if u.ndim == 1 else u[: count - 1]

        def state(z: Array) -> State:
            own = own_parameters(expected + jnp.matmul(root, z[2 * dim :], precision="highest"))
            here = own_law(law, own)
            constants = jnp.mean(jax.vmap(here.constraint)(x), axis=0)
            position = here.project_position(z[:dim], constants)
            velocity = here.project_velocity(position, z[dim : 2 * dim] / clock)
            return State(Motion(position, velocity), {"constants": constants, **own})

        def residuals(z: Array) -> tuple[Array, Array]:
            first = state(z)
            off = (dynamics.rollout(first, inputs, dt, count - 1).x - x).reshape(count, -1, 2)
            unexpected = (first.parameters["constants"] - self.prior.constants) / self.prior.spread
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
            # The projections remove some directions of z; the damping keeps the matrix regular there.
            damped = normal + jnp.diag(damping * diagonal + 1e-6 * jnp.max(diagonal))
            moved = z - jnp.linalg.solve(damped, slope)
            there = cost(moved)
            better = there < least
            damping = jnp.where(better, jnp.maximum(damping / 5, 1e-6), jnp.minimum(damping * 8, 1e4))
            return (jnp.where(better, moved, z), jnp.where(better, there, least), damping), None

        def search(place: Array) -> tuple[Array, Array]:
            rest = jnp.zeros(len(expected) - 2)
            z = jnp.concatenate([x[0], clock * (x[1] - x[0]) / dt, place, rest])
            (z, least, _), _ = jax.lax.scan(improve, (z, cost(z), jnp.asarray(1e-2)), length=_STEPS)
            return z, least

        places = _AWAY * jnp.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        ends, costs = jax.vmap(search)(places)
        return state(ends[jnp.argmin(costs)]), None


def light_of(
    frames: Float[Array, "n H W 3"], background: Float[Array, "H W 3"], keypoints: Float[Array, "n K 2"]
) -> Float[Array, "K 4"]:
    """Return the light that each part adds to the background: logarithm of its size, and its direction in colours.

        a_k = mean_t Σ_p w_tpk (z_tp − z̄_p) / HW · 100,    w_tpk ∝ exp(−|x_p − x_tk|²/2s²),  Σ_k w_tpk = 1,  s = 0.1
        l_k = (log |a_k|, a_k / |a_k|)

    A sum over the pixels of a part knows its size a hundred times better than one pixel knows its value. A part of
    twice the area and the same colour adds twice the light: the logarithm makes one step of this, whatever the colour.

    Args:
        frames: z, values in [0, 1].
        background: z̄, the mean frame of the training data.
        keypoints: x, image-plane units.
    """
    height, width = background.shape[:2]
    grid = image_grid(height, width, 1)
    away = jnp.sum((grid[None, :, :, None] - keypoints[:, None, None]) ** 2, axis=-1)
    near = jax.nn.softmax(-away / (2 * _REACH**2), axis=-1)
    added = frames - background[None]
    a = jnp.mean(jnp.sum(near[..., None] * added[:, :, :, None], axis=(1, 2)), axis=0) * 100 / (height * width)
    size = jnp.sqrt(jnp.sum(a**2, axis=1, keepdims=True) + _DARK**2)
    return jnp.concatenate([jnp.log(size), a / size], axis=1)


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
