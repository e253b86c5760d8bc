"""The losses of the stages of `fast`. Each takes the model and a batch of clips, and applies `vmap` itself.

All of them sum over pixels and average over frames, as the released code does; arXiv v1 prints sums over frames.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from keycld._shares import over_clips
from keycld.data import Clip
from keycld.mechanics import Scalar, State
from keycld.models.keycld.exchange import arranged, nearest_order, shuffled
from keycld.models.keycld.model import AbstractKeypointModel
from keycld.models.keycld.patches import shared_patches
from keycld.stages import AbstractLoss, Terms
from keycld.vision import DenseEstimator, KeypointEstimator, Observation, gaussian_maps, image_grid

# Least σ of the Gaussians of L_h, cells of a heat map.
_WIDE = 0.75
# Width of what a keypoint covers at last, image-plane units.
_NEAR = 0.1


class VisionLoss(AbstractLoss):
    """Loss of single frames: L = L_r + w_h L_h + Σ_i w_i(t) U_i − w_s(t) S.

        L_r = mean over frames of |z' − z|²                 reconstruction, sum over pixels, eq. (10)
        L_h = mean over frames of Σ_k Σ_p b log(b / s)      heat maps s against Gaussians b at their own keypoints
        U_i = mean over frames of (Φ_i − mean Φ_i)² / |DΦ_i|²    unevenness of constraint i, a squared length

    b ∝ exp(−|x_p − x_k|²/2σ²), normalised and without gradient, keeps the heat maps single-peaked. It has at least ¾ of
    the width of a cell: a narrower one nearly vanishes between the centres of the cells, and keypoints there come out
    three times less precise (`results/priors-keycld.md`). Only DΦ enters eq. (6), so the values of Φ are free, but they
    must be constant: no dynamics can follow keypoints whose distance to the pivot changes with the angle (arXiv v1,
    Fig. 13b). Unknown pivots and directions are those that fit the batch best. t = min(step / steps, 1) is the progress
    of the stage. Where the parts look different in each recording, a clip has two frames, and each is rendered with the
    looks that are seen in the other: so looks cannot hide positions. S is how alike the patches around each keypoint
    are in all frames (`shared_patches`).

    Source: arXiv v1, eq. (10), for L_r; L_h after the heat-map loss of the 2024 version; U and S are ours.

    Attributes:
        heat_map: w_h.
        constraint: w_i at t = 0 and at t = 1, linear between, for constraints on one keypoint. They tell the keypoints
            apart, so they act from the first step.
        coupling: w_i for t ≤ 0.1, for constraints on several keypoints; above zero. It grows by equal factors until
            t = 0.4, to the last value of `constraint`. Keypoints that move as one satisfy such constraints; a large
            weight from the first step would keep them from finding their parts (`results/recipe.md`).
        joints: while t is less, constraints on several keypoints move only joints, not ends (`_ends`). A joint has one
            correct position. Before it is found, the end could make the distance constant as well, by errors of up to
            a pixel to either side of its part, and no dynamics moves like that.
        coverage: w_c at t = 0, falling to 0 at t = 1/4, of the gradient of
            C = mean over frames of −(s/σ)² Σ_p e_p log Σ_k b_k(p) − 1/K Σ_k log Σ_p m_p b_k(p),
            b_k(p) = exp(−|x_p − x_k|²/2s²), with e the squared error of the rendered pixels and m the squared
            difference of the frame from the mean frame, both as shares of the mean of Σ m. The first part pulls
            keypoints to what the rendered frames lack, as reconstruction alone does not: that never moves a keypoint to
            a part that it is not near. The second part holds keypoints on what moves: otherwise they may encode the
            parts from any place. s falls by equal factors from `spread` to σ = 0.1 at t = 1/5.
            C helps where parts are small and near each other, and harms elsewhere, so it is for some of the candidates.
            The value of L does not contain it, so that candidates with and without can be compared.
        missing: weight of the first part of C. 0 for a clip with one keypoint: no other part can be missing, and what
            is rendered last, such as a thin string, would pull the keypoint off the ball at its end.
        spread: s at t = 0, image-plane units. While it is wide, all keypoints share in a part that is missing. With 0.1
            the nearest one takes all: in an animation of a double pendulum it went to the elbow, while the other one
            stayed at the pivot, near which it had begun, and told by less than a pixel where the tip is. With 0.5 both
            found their parts. On a four-bar linkage 0.1 does better (`results/watched-clips.json`, `animations`).
        centre: weight at t = 0, falling to 0 at t = 1, of the gradient of the second part alone, for free keypoints, on
            which no constraint acts. Nothing else says where on its part a free keypoint is, and forces act between
            centres: no central force explained two keypoints that were each a pixel off theirs, to opposite sides
            (`results/priors-keycld.md`). Near the end it would only add the noise of the pixels.
        patches: w_s at t = 0.35 and for t ≥ 0.7, linear between. Before, it grows linearly from zero at t = 0.1:
            it would keep keypoints that have not found their parts yet on the part that stands out most. Along a rod of
            one colour all patches are alike, and those nearer to its pivot most, so the last value is zero: in long
            motions constant distances tell the joint more exactly.
        patch: width of these patches, image-plane units.
        steps: steps of the stage; a float, because the compiled program does not depend on floats.
        sigma: σ of b, image-plane units; less than ¾ of a heat-map cell counts as that.
        free: all keypoints are free, and all w_i zero: for recordings with places and lengths of their own, where
            nothing is even, and for parts that exchange their looks, where a keypoint is another part in each
            recording. The keypoints of the latter are rendered in a random order.
    """

    heat_map: float = 1.0
    constraint: tuple[float, float] = (100.0, 1000.0)
    coupling: float = 10.0
    joints: float = 0.85
    coverage: float = 0.0
    missing: float = 1.0
    spread: float = 0.1
    centre: float = 1.0
    patches: tuple[float, float] = (2.0, 0.0)
    patch: float = 0.06
    steps: float = 1000.0
    sigma: float = 0.05
    free: bool = eqx.field(static=True, default=False)

    def __call__(
        self, model: AbstractKeypointModel, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluate the loss.

        Args:
            model: with an estimator, a renderer and constraints.
            clips: single frames, `[B, 1, H, W, 3]` in [0, 1], or pairs for a model that knows looks.
            key: for the order of parts that exchange their looks.
            step: step of the stage, for the weights.
        """
        assert clips.frames is not None
        frames = clips.frames.reshape(-1, *clips.frames.shape[-3:])
        observed = jax.vmap(model.estimator)(frames)
        if model.exchange:
            observed = shuffled(observed, clips.frames.shape[1], key)
        x = observed.keypoints.reshape(frames.shape[0], -1)
        done = jnp.minimum(step / self.steps, 1.0)
        fixed = _ends(model, x) & (done < self.joints)
        located = model.located(jax.lax.stop_gradient(x))
        uneven, couples = unevenness(located, jnp.where(fixed[None, :], jax.lax.stop_gradient(x), x))
        rendered = jax.vmap(model.renderer)(observed.keypoints, _other_looks(observed.looks, clips.frames))
        terms = {
            "reconstruction": squared_error(rendered, frames),
            "heat_map": _divergence(observed, (frames.shape[1], frames.shape[2]), self.sigma),
            "constraint": jnp.sum(uneven),
            "patches": -shared_patches(model, observed.keypoints, frames, self.patch),
        }
        width = _NEAR * (self.spread / _NEAR) ** jnp.maximum(0.0, 1 - 5 * done)
        covered, held = _found(model, observed.keypoints, rendered, frames, width)
        _, found = _found(model, observed.keypoints, rendered, frames)
        free = jnp.all(_slopes(model, x) == 0, axis=(0, 1))
        free = jnp.ones_like(free) if self.free else free
        pull = self.coverage * jnp.maximum(0.0, 1 - 4 * done) * -(self.missing * covered + jnp.mean(held))
        pull = pull - self.centre * (1 - done) * jnp.sum(jnp.where(free, found, 0.0))
        first, last = self.constraint
        growth = (last / self.coupling) ** jnp.clip((done - 0.1) / 0.3, 0.0, 1.0)
        weights = jnp.where(couples, self.coupling * growth, first + (last - first) * done)
        weights = jnp.zeros_like(weights) if self.free else weights
        total = (
            terms["reconstruction"]
            + self.heat_map * terms["heat_map"]
            + jnp.sum(weights * uneven)
            + jnp.interp(done, jnp.array([0.1, 0.35, 0.7]), jnp.array([0.0, *self.patches])) * terms["patches"]
        )
        return total + pull - jax.lax.stop_gradient(pull), terms


class TrackLoss(AbstractLoss):
    """Loss of roll-outs on cached keypoints: their mean pseudo-Huber distance.

        L = mean over clips, roll-outs and frames of Σ_c 2 s² (√(1 + (x̂_c − x_c)²/s²) − 1)

    c counts components. Each group of consecutive frames in a clip gives an initial state, whose roll-out x̂ passes all
    frames of the clip; x are the cached keypoints. The distance is (x̂_c − x_c)² where it is small and grows linearly
    where a roll-out has diverged. Ours, in no paper.

    Attributes:
        scale: s, image-plane units; 0.1 for a first training of the dynamics.
    """

    scale: float = 0.1

    def __call__(
        self, model: AbstractKeypointModel, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluate the loss on groups of cached keypoints, `[B, F, 2K]`; `key` and `step` are not used."""
        assert clips.cached is not None
        rolled = _rolled_out(model, clips.cached, clips)
        track = _distance(rolled, clips.cached, self.scale)
        return track, {"track": track}


class PredictionLoss(AbstractLoss):
    """Loss of predictions, for all parts together: L = L_r + w_t L_t + w_c Σ_i U_i + w_h L_h.

    L_t is the pseudo-Huber distance between roll-outs and observed keypoints (`TrackLoss`), U_i and L_h are those of
    `VisionLoss`. L_r is the reconstruction error, eq. (10), of frames rendered from rolled-out keypoints: one random
    frame of each group of consecutive frames, because they differ little, from its own roll-out or that of an earlier
    group, sampled uniformly. The estimator is thus trained for initial states that give good long predictions. Looks,
    where recordings differ in them, are the means over the clip. Ours, in no paper.

    Attributes:
        track: w_t, for squared distances in image-plane units. With 3000 an error of an eighth of a pixel costs as much
            as a usual reconstruction error.
        constraint: w_c.
        heat_map: w_h.
        sigma: σ of the Gaussians of L_h, image-plane units; at least ¾ of a heat-map cell.
        scale: s of the pseudo-Huber distance, image-plane units. Diverged roll-outs, such as those backward from a fast
            pole, have errors of 0.5; those that training can correct have 0.01 and must still count.
    """

    track: float = 3000.0
    constraint: float = 100.0
    heat_map: float = 1.0
    sigma: float = 0.05
    scale: float = 0.03

    def __call__(
        self, model: AbstractKeypointModel, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluate the loss.

        Args:
            model: with all parts.
            clips: groups of `model.context` consecutive frames, `[B, F, H, W, 3]` in [0, 1].
            key: for the choice of frames and roll-outs that are rendered.
            step: not used.
        """
        assert clips.frames is not None
        batch, count, height, width, _ = clips.frames.shape
        observed = model.observe_clips(clips.frames)
        x = observed.keypoints.reshape(batch, count, -1)
        rolled = _rolled_out(model, x, clips)
        # From each group a frame, and its own roll-out or an earlier one.
        row, own = jnp.arange(batch)[:, None], jnp.arange(rolled.shape[1])[None, :]
        source_key, frame_key = jax.random.split(key)
        source = jax.random.randint(source_key, (batch, own.size), 0, own + 1)
        frame = own * model.context + jax.random.randint(frame_key, (batch, own.size), 0, model.context)
        chosen = rolled[row, source, frame].reshape(batch * own.size, -1, 2)
        target = clips.frames[row, frame].reshape(-1, height, width, 3)
        looks = observed.looks
        if looks is not None:
            looks = jnp.mean(looks.reshape(batch, count, *looks.shape[1:]), axis=1).repeat(own.size, axis=0)
        terms = {
            "reconstruction": squared_error(jax.vmap(model.renderer)(chosen, looks), target),
            "track": _distance(rolled, x, self.scale),
            "constraint": jnp.sum(unevenness(model, x.reshape(batch * count, -1))[0]),
            "heat_map": _divergence(observed, (height, width), self.sigma),
        }
        total = (
            terms["reconstruction"]
            + self.track * terms["track"]
            + self.constraint * terms["constraint"]
            + self.heat_map * terms["heat_map"]
        )
        return total, terms


class SmoothedLoss(AbstractLoss):
    """Loss of single frames with fitted positions: L = L_r + w_t L_t + w_h L_h.

    Fitted motions average the errors of many observed keypoints, so their positions are better than the observed ones.
    The estimator learns them: L_t is the pseudo-Huber distance of observed keypoints from them (`TrackLoss`). L_r and
    L_h are those of `VisionLoss`, but frames are rendered from the fitted positions, with the looks that are seen in
    the other frame of a clip. For models whose recordings have own parameters, which two frames do not show: no
    roll-out could begin there (`PredictionLoss`). Ours, in no paper.

    Attributes:
        track: w_t, for squared distances in image-plane units.
        heat_map: w_h.
        sigma: σ of the Gaussians of L_h, image-plane units; at least ¾ of a heat-map cell.
        scale: s of the pseudo-Huber distance, image-plane units.
    """

    track: float = 3000.0
    heat_map: float = 1.0
    sigma: float = 0.05
    scale: float = 0.03

    def __call__(
        self, model: AbstractKeypointModel, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluate the loss; `key` and `step` are not used.

        Args:
            model: with estimator and renderer.
            clips: frames `[B, F, H, W, 3]` in [0, 1], and fitted positions `[B, F, 2K]`.
            key: not used.
            step: not used.
        """
        assert clips.frames is not None and clips.cached is not None
        frames = clips.frames.reshape(-1, *clips.frames.shape[-3:])
        fitted = clips.cached.reshape(len(frames), -1, 2)
        observed = jax.vmap(model.estimator)(frames)
        if model.exchange:
            observed = arranged(observed, nearest_order(observed.keypoints, fitted))
        terms = {
            "reconstruction": squared_error(
                jax.vmap(model.renderer)(fitted, _other_looks(observed.looks, clips.frames)), frames
            ),
            "track": _distance(
                observed.keypoints.reshape(1, 1, len(frames), -1), fitted.reshape(1, len(frames), -1), self.scale
            ),
            "heat_map": _divergence(observed, (frames.shape[1], frames.shape[2]), self.sigma),
        }
        total = terms["reconstruction"] + self.track * terms["track"] + self.heat_map * terms["heat_map"]
        return total, terms


def _other_looks(looks: Array | None, frames: Array) -> Array | None:
    """Return the looks that are seen in the other frame of each clip `[B, 2, …]`."""
    if looks is None:
        return None
    per_clip = looks.reshape(frames.shape[0], -1, *looks.shape[1:])
    return jnp.roll(per_clip, 1, axis=1).reshape(looks.shape)


def _rolled_out(model: AbstractKeypointModel, observed: Array, clips: Clip) -> Array:
    """Return positions `[batch, groups, F, 2K]` at the clips' frames, of a roll-out from each group of observations."""
    given = model.context

    def one(model: AbstractKeypointModel, x: Array, index: Array, u: Array, dt: Array) -> Array:
        def inputs(frames: Array) -> Array:
            # Positions beyond the clip are not read, so any input serves there.
            return u if u.ndim == 1 else u[jnp.clip(frames, 0, clips.span - 1)]

        def motion(group: Array, first: Array) -> Array:
            initial = model.initial_state(model.dynamics, group, dt, inputs(first + jnp.arange(given)))
            now = first + model.initial_state.anchor

            def pass_frame(state: State, k: Array) -> tuple[State, Array]:
                # Backward to the clip's first frame, then forward from the initial state: each frame is passed once.
                state = jax.tree.map(lambda here, there: jnp.where(k == now, there, here), state, initial)
                frame, sign = jnp.where(k < now, now - 1 - k, k), jnp.where(k < now, -1.0, 1.0)
                state = model.dynamics.step(state, inputs(frame), sign * dt)
                return state, state.coordinates.x

            _, path = jax.lax.scan(pass_frame, initial, jnp.arange(clips.span - 1))
            passed = path[jnp.where(index < now, now - 1 - index, jnp.maximum(index - 1, 0))]
            return jnp.where((index == now)[:, None], initial.coordinates.x, passed)

        return jax.vmap(motion)(x.reshape(-1, given, x.shape[-1]), index[::given])

    return over_clips(one, model, observed, clips.index, clips.u, clips.dt)


def unevenness(model: AbstractKeypointModel, x: Array) -> tuple[Array, Array]:
    """Return the unevenness U_i of each constraint over a batch `[B, 2K]`, and whether it is on several keypoints.

    The division by |DΦ_i|² makes U_i independent of the scale of Φ_i. Without it keypoints would move together: the
    variance of a squared distance d² is 4d² times that of d.
    """
    values, slopes = jax.vmap(model.constraint)(x), _slopes(model, x)
    couples = jnp.sum(jnp.any(slopes > 0, axis=0), axis=-1) > 1
    spread = (values - jnp.mean(values, axis=0)[None, :]) ** 2
    return jnp.mean(spread / (jnp.sum(slopes, axis=-1) + 1e-6), axis=0), couples


def _found(
    model: AbstractKeypointModel, keypoints: Array, rendered: Array, frames: Array, width: Array | float = _NEAR
) -> tuple[Array, Array]:
    """Return how far keypoints `[batch, K, 2]` cover what the rendered frames lack, and each what moves, for C."""
    assert isinstance(model.estimator, (KeypointEstimator, DenseEstimator)) and model.estimator.standardise is not None
    mean, deviation = model.estimator.standardise.mean, model.estimator.standardise.deviation
    pixels = jnp.stack([frames - rendered, frames - mean[None]]) / (deviation * jnp.sqrt(frames[0].size) + 1e-6)
    missing, moving = jax.lax.stop_gradient(jnp.sum(pixels**2, axis=-1))
    grid = image_grid(frames.shape[1], frames.shape[2], 1)
    apart = jnp.sum((grid[None, :, :, None] - keypoints[:, None, None]) ** 2, axis=-1)
    near = -apart / (2 * width**2)
    found = jnp.log(jnp.sum(moving[..., None] * jnp.exp(near), axis=(1, 2)) + 1e-4)
    covered = (width / _NEAR) ** 2 * jnp.sum(missing * jax.nn.logsumexp(near, axis=-1), axis=(1, 2))
    return jnp.mean(covered), jnp.mean(found, axis=0)


def _ends(model: AbstractKeypointModel, x: Array) -> Array:
    """Return which components `[2K]` belong to ends: keypoints under one constraint, which is shared with a joint.

    A joint is a keypoint under several constraints.
    """
    touched = jnp.any(_slopes(model, x) > 0, axis=0)
    joint = jnp.sum(touched, axis=0) > 1
    to_joint = jnp.any(touched & joint[None, :], axis=1)
    return jnp.repeat(~joint & jnp.any(touched & to_joint[:, None], axis=0), 2)


def _slopes(model: AbstractKeypointModel, x: Array) -> Array:
    """Return |∂Φ_i/∂x_k|² as `[batch, constraint, keypoint]`."""
    jacobian = jax.vmap(jax.jacfwd(model.constraint))(x)
    return jnp.sum(jacobian.reshape(*jacobian.shape[:2], x.shape[-1] // 2, 2) ** 2, axis=-1)


def squared_error(rendered: Float[Array, "B H W 3"], frames: Float[Array, "B H W 3"]) -> Float[Array, ""]:
    """Return the squared error, summed over pixels and channels, mean over frames."""
    return jnp.mean(jnp.sum((rendered - frames) ** 2, axis=(1, 2, 3)))


def _distance(rolled: Array, observed: Array, scale: Scalar) -> Array:
    """Return the mean pseudo-Huber distance of roll-outs `[batch, groups, F, 2K]` from keypoints `[batch, F, 2K]`."""
    error = rolled - observed[:, None]
    return jnp.mean(jnp.sum(2 * scale**2 * (jnp.sqrt(1 + (error / scale) ** 2) - 1), axis=-1))


def _divergence(observed: Observation, size: tuple[int, int], sigma: Scalar) -> Array:
    """Return the divergence L_h of heat maps from Gaussians at their own keypoints; 0 without heat maps."""
    maps = observed.heat_maps
    if maps is None:
        return jnp.zeros(())
    grid = image_grid(*size, size[0] // maps.shape[-2])
    wide = jnp.maximum(sigma, _WIDE * (grid[0, 1, 0] - grid[0, 0, 0]))
    blobs = jax.vmap(lambda x: gaussian_maps(x, grid, wide))(jax.lax.stop_gradient(observed.keypoints))
    target = blobs.transpose(0, 3, 1, 2)
    target = target / (jnp.sum(target, axis=(2, 3), keepdims=True) + 1e-12)
    divergence = target * (jnp.log(target + 1e-12) - jnp.log(maps + 1e-12))
    return jnp.mean(jnp.sum(divergence, axis=(1, 2, 3)))
