"""What patches around keypoints share: it is most where keypoints are fixed to the parts that they follow."""

import jax
import jax.numpy as jnp
from jax.scipy.ndimage import map_coordinates
from jaxtyping import Array, Float

from keycld.mechanics import AbstractDisplacement, ConstrainedLagrangian, Constraints
from keycld.models.keycld.model import AbstractKeypointModel
from keycld.vision import DenseEstimator, KeypointEstimator

# Points of a patch along a side, and half of its side in units of its width.
_POINTS, _REACH = 13, 2.5
_BLUR = 1.0
# Energy of a patch, and variance of a colour, that count as nothing.
_FLOOR, _DIM = 1e-2, 0.02


def shared_patches(
    model: AbstractKeypointModel,
    keypoints: Float[Array, "B K 2"],
    frames: Float[Array, "B H W 3"],
    width: Float[Array, ""] | float,
) -> Float[Array, ""]:
    """Return how alike the patches around each keypoint are in all frames: the logarithm of what they share.

        S = Σ_k (log(ε + |mean over frames of P_k|²) − ½ log(ε + mean over frames of |P_k|²))
        P_k(g) = D(x_k + R_k g) Π_{j≠k} (1 − b(x_k + R_k g − x_j)),    |P|² = Σ_g b(g) |P(g)|² / Σ_g b(g)

    D is a frame minus the background, blurred by a pixel, with whitened colours: a part counts that stands out by its
    hue, even if a bright rod leads to it. g are the points of a patch around the keypoint, b(g) = exp(−|g|²/2s²); R_k
    turns the patch with the link that ends at keypoint k: along x_k − p for a keypoint at a constant distance from p,
    along x_k − x_j for one at a constant distance from keypoint j alone, otherwise not at all. The product leaves a
    part to one keypoint, and the second logarithm keeps bright frames from pulling their keypoints away.

    Frames are reconstructed through keypoints that lie anywhere, as long as they move as their parts do: on circles
    around other centres, with other radii. On 263 frames of a real pendulum the pivot was 0.2 away; on a four-bar
    linkage two keypoints were three pixels below their joints, where all distances are constant too, and accelerations
    14 % wrong. Patches around keypoints that are fixed to a part show the same in all frames, and their mean is as
    strong as each of them; the mean patch of all others is blurred, and that of a place at rest is zero. A keypoint on
    a ball goes to its middle, where the patch contains most of it. Ours, in no paper.

    Args:
        model: with an estimator that knows the background, and a law that says which links end at a keypoint.
        keypoints: x_k, image-plane units.
        frames: in [0, 1].
        width: s, image-plane units; 0.06 is three pixels of 100.
    """
    assert isinstance(model.estimator, (KeypointEstimator, DenseEstimator)) and model.estimator.standardise is not None
    moving = _whitened(_blurred(jax.vmap(model.estimator.standardise)(frames)))
    _, height, size, _ = frames.shape
    located = model.located(jax.lax.stop_gradient(keypoints.reshape(len(keypoints), -1)))
    law = located.moving_law
    phi = law.constraint_function if isinstance(law, ConstrainedLagrangian) else None
    along = jax.vmap(lambda points: _directions(phi, points))(keypoints)
    side = _REACH * width * jnp.linspace(-1, 1, _POINTS)
    grid = jnp.stack(jnp.meshgrid(side, side), axis=-1).reshape(-1, 2)
    across = jnp.stack([-along[..., 1], along[..., 0]], axis=-1)
    turned = grid[None, None, :, :1] * along[:, :, None] + grid[None, None, :, 1:] * across[:, :, None]
    places = keypoints[:, :, None] + turned
    half = (min(height, size) - 1) / 2
    rows, columns = (height - 1) / 2 - half * places[..., 1], (size - 1) / 2 + half * places[..., 0]

    def sampled(frame: Array, rows: Array, columns: Array) -> Array:
        return jnp.stack([map_coordinates(frame[..., c], [rows, columns], 1, mode="nearest") for c in range(3)], -1)

    far = jnp.sum((places[:, :, :, None] - keypoints[:, None, None]) ** 2, axis=-1)
    others = 1 - jnp.eye(keypoints.shape[1])[None, :, None]
    own = jnp.prod(1 - others * jnp.exp(-far / (2 * width**2)), axis=-1)
    patches = jax.vmap(sampled)(moving, rows, columns) * own[..., None]
    weight = jnp.exp(-jnp.sum(grid**2, axis=-1) / (2 * width**2))
    weight = weight / jnp.sum(weight)
    shared = jnp.einsum("g,kgc->k", weight, jnp.mean(patches, axis=0) ** 2)
    all_of_them = jnp.einsum("g,bkgc->k", weight, patches**2) / len(frames)
    return jnp.sum(jnp.log(shared + _FLOOR) - 0.5 * jnp.log(all_of_them + _FLOOR))


def _directions(phi: object, points: Float[Array, "K 2"]) -> Float[Array, "K 2"]:
    """Return the unit vector with which the patch of each keypoint turns."""
    still = jnp.array([1.0, 0.0])
    if not isinstance(phi, Constraints):
        return jnp.broadcast_to(still, points.shape)
    at = dict(zip(phi.keypoints, points, strict=True))
    found = []
    for name in phi.keypoints:
        links = [item for item in phi.items if isinstance(item, AbstractDisplacement) and name in item.keypoints]
        own = [item for item in links if len(item.keypoints) == 1]
        link = (own or links or [None])[0]
        if link is None or link.normal is not None:
            found.append(still)
            continue
        others = [other for other in link.keypoints if other != name]
        away = at[name] - (at[others[0]] if others else jnp.asarray(link.origin({})))
        found.append(away * jax.lax.rsqrt(jnp.sum(away**2) + 1e-6))
    return jnp.stack(found)


def _blurred(frames: Array) -> Array:
    """Return frames `[B, H, W, 3]` convolved with a Gaussian of about a pixel."""

    def smooth(length: int) -> Array:
        apart = jnp.arange(length)[:, None] - jnp.arange(length)[None, :]
        weights = jnp.exp(-(apart**2) / (2 * _BLUR**2))
        return weights / jnp.sum(weights, axis=1, keepdims=True)

    return jnp.einsum("ij,bjkc,lk->bilc", smooth(frames.shape[1]), frames, smooth(frames.shape[2]))


def _whitened(frames: Array) -> Array:
    """Return differences `[B, H, W, 3]` in colours that are not correlated and vary alike; dim ones stay dim."""
    covariance = jnp.einsum("bhwc,bhwd->cd", frames, frames)
    values, vectors = jnp.linalg.eigh(3 * covariance / (jnp.trace(covariance) + 1e-12) + _DIM * jnp.eye(3))
    return jnp.einsum("bhwc,cd->bhwd", frames, (vectors / jnp.sqrt(values)[None]) @ vectors.T)
