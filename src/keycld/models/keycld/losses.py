"""The losses of KeyCLD's training stages. Each takes the model and a batch of clips; only this file batches.

Pixels are summed and frames averaged throughout, as in the released code (the paper's eqs. 10 and 13 print sums
over frames; λ = 5e-4 belongs to the averages).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from keycld.data import Clip
from keycld.mechanics import State
from keycld.models.keycld.model import AbstractKeypointModel
from keycld.stages import AbstractLoss, Terms
from keycld.vision import gaussian_maps, image_grid


class VisionLoss(AbstractLoss):
    """Learns to see, from single frames: the picture must pass through the keypoints.

    reconstruction + `heat_map` · focus + weights · unevenness of Φ, the weights growing.

    - `heat_map`: weight of the cross-entropy between each heat map and a Gaussian of width `sigma` at its own
      (stop-gradient) keypoint, which keeps the maps single-peaked (the 2024 version's loss).
    - `constraint`: weight of the unevenness of the constraint functions over the batch, at the first and at the last
      of `steps` steps, linear between. Only DΦ enters eq. (6), so the constants are free, but they must be
      *constants*: where the distance to the pivot changes with the angle (paper, Fig. 13b) no dynamics can follow.
    - `coupling`: the same weight at first for constraints on several keypoints. It stays for a tenth of the steps,
      grows by equal factors for three tenths, and is then the last one of `constraint`; above zero. What ties one
      keypoint to the world tells keypoints apart, and must bind at once; what ties keypoints to each other holds
      from the first step where they move as one, and would keep them from ever finding their parts
      (`docs/recipe.md` has the figures).
    - `joints`: share of the steps in which such constraints are mended by joints alone (`_ends`). A joint has one
      right place. Where it is not there yet, the keypoint at the other end could make the distance constant too, by
      being seen beside its part, a pixel to and fro, and no dynamics moves like that.
    - `steps`: of the stage.
    - `sigma`: image-plane units.
    """

    heat_map: float = 1.0
    constraint: tuple[float, float] = (100.0, 1000.0)
    coupling: float = 10.0
    joints: float = 0.85
    steps: int = 1000
    sigma: float = 0.05

    def __call__(
        self, model: AbstractKeypointModel, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluates the loss on clips of one frame each."""
        assert clips.frames is not None
        frames = clips.frames.reshape(-1, *clips.frames.shape[-3:])
        seen = jax.vmap(model.observe)(frames)
        x = seen.keypoints.reshape(frames.shape[0], -1)
        done = jnp.minimum(step / self.steps, 1.0)
        left_alone = _ends(model, x) & (done < self.joints)
        uneven, couples = _unevenness(model, jnp.where(left_alone[None, :], jax.lax.stop_gradient(x), x))
        terms = {
            "reconstruction": squared_error(jax.vmap(model.renderer)(seen.keypoints), frames),
            "heat_map": _focus(seen.heat_maps, seen.keypoints, (frames.shape[1], frames.shape[2]), self.sigma),
            "constraint": jnp.sum(uneven),
        }
        first, last = self.constraint
        growth = (last / self.coupling) ** jnp.clip((done - 0.1) / 0.3, 0.0, 1.0)
        weights = jnp.where(couples, self.coupling * growth, first + (last - first) * done)
        total = terms["reconstruction"] + self.heat_map * terms["heat_map"] + jnp.sum(weights * uneven)
        return total, terms


class TrackLoss(AbstractLoss):
    """Learns to move, from cached keypoints: each group of a clip starts a motion through all groups.

    Mean over motions and frames of the pseudo-Huber distance 2s²(√(1 + (Δx/s)²) − 1), summed over components,
    between the roll-out and the cached keypoints: Δx² while small, growing linearly where a roll-out has lost its way.

    - `scale`: s, in image-plane units.
    """

    scale: float = 0.1

    def __call__(
        self, model: AbstractKeypointModel, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluates the loss on clips of cached keypoints."""
        assert clips.cached is not None
        rolled = _rolled_out(model, clips.cached, clips)
        track = _distance(rolled, clips.cached, self.scale)
        return track, {"track": track}


class PredictionLoss(AbstractLoss):
    """Sees and moves together: each group of a clip starts a motion, and every frame is drawn from one of them.

    reconstruction of the rolled-out keypoints + `track` · |rolled-out − seen|² over all motions and frames
    + `constraint` · unevenness of Φ + `heat_map` · focus. The encoder is thus judged by how well two of its keypoint
    sets start a long motion, which is what decides a prediction.

    - `track`: weight of the squared distance in image-plane units; 3000 makes an eighth of a pixel cost what an
      ordinary reconstruction error costs.
    - `scale`: s of the pseudo-Huber distance that stands for the square (see `TrackLoss`). Motions that are lost, as
      those backward from a fast pole often are, miss by 0.5; those that can be mended, by 0.01, and must not count for
      nothing.
    """

    track: float = 3000.0
    constraint: float = 100.0
    heat_map: float = 1.0
    sigma: float = 0.05
    scale: float = 0.03

    def __call__(
        self, model: AbstractKeypointModel, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluates the loss on clips of groups of consecutive frames."""
        assert clips.frames is not None
        batch, count, height, width, _ = clips.frames.shape
        frames = clips.frames.reshape(-1, height, width, 3)
        seen = jax.vmap(model.observe)(frames)
        x = seen.keypoints.reshape(batch, count, -1)
        rolled = _rolled_out(model, x, clips)
        # Each group's frames are drawn from its own motion or an earlier one, whichever comes up.
        own = jnp.arange(rolled.shape[1])[None, :]
        lot = jax.random.randint(key, (batch, own.size), 0, own + 1)
        source = jnp.repeat(lot, model.context, axis=1)
        chosen = rolled[jnp.arange(batch)[:, None], source, jnp.arange(count)[None, :]]
        drawn = jax.vmap(model.renderer)(chosen.reshape(frames.shape[0], -1, 2))
        terms = {
            "reconstruction": squared_error(drawn, frames),
            "track": _distance(rolled, x, self.scale),
            "constraint": jnp.sum(_unevenness(model, x.reshape(batch * count, -1))[0]),
            "heat_map": _focus(seen.heat_maps, seen.keypoints, (height, width), self.sigma),
        }
        total = (
            terms["reconstruction"]
            + self.track * terms["track"]
            + self.constraint * terms["constraint"]
            + self.heat_map * terms["heat_map"]
        )
        return total, terms


class CollocationLoss(AbstractLoss):
    """The paper's loss L = L_r + λ L_d, eqs. (10)–(13): reconstruction, and accelerations without integration.

    L_d compares central differences taken twice, (x_{i+2} − 2x_i + x_{i−2}) / 4h², with eq. (6) at the central
    difference of the velocity.

    - `weight`: λ = 5e-4.
    """

    weight: float = 5e-4

    def __call__(
        self, model: AbstractKeypointModel, clips: Clip, *, key: PRNGKeyArray, step: Int[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """Evaluates the loss on windows of at least five consecutive frames."""
        assert clips.frames is not None
        batch, count = clips.frames.shape[:2]
        frames = clips.frames.reshape(-1, *clips.frames.shape[2:])
        keypoints = jax.vmap(model.observe)(frames).keypoints
        law = model.moving_law

        def one(x: Array, u: Array, dt: Array) -> Array:
            velocity = (x[2:] - x[:-2]) / (2 * dt)
            seen = (velocity[2:] - velocity[:-2]) / (2 * dt)
            inputs = jnp.broadcast_to(u[None, :], (count - 4, u.shape[0])) if u.ndim == 1 else u[2 : count - 2]
            return seen - jax.vmap(law.acceleration)(x[2:-2], velocity[1:-1], inputs)

        defect = jax.vmap(one)(keypoints.reshape(batch, count, -1), clips.u, clips.dt)
        terms = {
            "reconstruction": squared_error(jax.vmap(model.renderer)(keypoints), frames),
            # As released: the interior frames' sum over the number of all frames.
            "dynamics": jnp.sum(defect**2) / (batch * count),
        }
        return terms["reconstruction"] + self.weight * terms["dynamics"], terms


def _rolled_out(model: AbstractKeypointModel, seen: Array, clips: Clip) -> Array:
    """Positions `[batch, groups, F, 2K]` at the clips' frames, of the motions that each group of sightings starts."""
    given = model.context

    def one(x: Array, index: Array, u: Array, dt: Array) -> Array:
        def inputs(frames: Array) -> Array:
            # Beyond the clip nothing is read, so any input will do.
            return u if u.ndim == 1 else u[jnp.clip(frames, 0, clips.span - 1)]

        def motion(group: Array, first: Array) -> Array:
            start = model.initial_state(model.dynamics, group, dt, inputs(first + jnp.arange(given)))
            now = first + model.initial_state.anchor

            def pass_frame(state: State, k: Array) -> tuple[State, Array]:
                # Backward to the clip's first frame, then forward from the start again: no frame is passed twice.
                state = jax.tree.map(lambda here, there: jnp.where(k == now, there, here), state, start)
                frame, sign = jnp.where(k < now, now - 1 - k, k), jnp.where(k < now, -1.0, 1.0)
                state = model.dynamics.step(state, inputs(frame), sign * dt)
                return state, state.coordinates.x

            _, path = jax.lax.scan(pass_frame, start, jnp.arange(clips.span - 1))
            passed = path[jnp.where(index < now, now - 1 - index, jnp.maximum(index - 1, 0))]
            return jnp.where((index == now)[:, None], start.coordinates.x, passed)

        return jax.vmap(motion)(x.reshape(-1, given, x.shape[-1]), index[::given])

    return jax.vmap(one)(seen, clips.index, clips.u, clips.dt)


def _unevenness(model: AbstractKeypointModel, x: Array) -> tuple[Array, Array]:
    """How far a batch of keypoints is from one common value of each Φᵢ, and which Φᵢ tie several keypoints.

    The first is mean (Φᵢ − mean Φᵢ)² / |DΦᵢ|², a squared length. Without the division keypoints would gain by coming
    together: the variance of a squared distance d² is 4d² times that of d.
    """
    values, slopes = jax.vmap(model.constraint)(x), _slopes(model, x)
    couples = jnp.sum(jnp.any(slopes > 0, axis=0), axis=-1) > 1
    spread = (values - jnp.mean(values, axis=0)[None, :]) ** 2
    return jnp.mean(spread / (jnp.sum(slopes, axis=-1) + 1e-6), axis=0), couples


def _ends(model: AbstractKeypointModel, x: Array) -> Array:
    """Which components `[2K]` belong to keypoints that a single constraint ties to a joint, itself under several."""
    touched = jnp.any(_slopes(model, x) > 0, axis=0)
    joint = jnp.sum(touched, axis=0) > 1
    to_joint = jnp.any(touched & joint[None, :], axis=1)
    return jnp.repeat(~joint & jnp.any(touched & to_joint[:, None], axis=0), 2)


def _slopes(model: AbstractKeypointModel, x: Array) -> Array:
    """|∂Φᵢ/∂xₖ|² `[batch, constraint, keypoint]`."""
    jacobian = jax.vmap(jax.jacfwd(model.constraint))(x)
    return jnp.sum(jacobian.reshape(*jacobian.shape[:2], x.shape[-1] // 2, 2) ** 2, axis=-1)


def squared_error(drawn: Float[Array, "B H W 3"], frames: Float[Array, "B H W 3"]) -> Float[Array, ""]:
    """Squares summed over pixels and channels, mean over frames."""
    return jnp.mean(jnp.sum((drawn - frames) ** 2, axis=(1, 2, 3)))


def _distance(rolled: Array, seen: Array, scale: float) -> Array:
    """Mean pseudo-Huber distance of all motions `[batch, groups, F, 2K]` from what was seen `[batch, F, 2K]`."""
    error = rolled - seen[:, None]
    return jnp.mean(jnp.sum(2 * scale**2 * (jnp.sqrt(1 + (error / scale) ** 2) - 1), axis=-1))


def _focus(maps: Array | None, keypoints: Array, size: tuple[int, int], sigma: float) -> Array:
    """Cross-entropy between each heat map and a Gaussian at its own keypoint, minus the Gaussian's entropy."""
    if maps is None:
        return jnp.zeros(())
    grid = image_grid(*size, size[0] // maps.shape[-2])
    blobs = jax.vmap(lambda x: gaussian_maps(x, grid, sigma))(jax.lax.stop_gradient(keypoints))
    target = blobs.transpose(0, 3, 1, 2)
    target = target / (jnp.sum(target, axis=(2, 3), keepdims=True) + 1e-12)
    divergence = target * (jnp.log(target + 1e-12) - jnp.log(maps + 1e-12))
    return jnp.mean(jnp.sum(divergence, axis=(1, 2, 3)))
