"""What the parts add to a still background: how much light, of which colour, and exactly where."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from keycld.vision import fit_discs, image_grid, pixel_size

# s of the shares of parts in a pixel.
_REACH = 0.1
# Less light than this, per cent of a white picture, has no direction.
_DARK = 1e-4
# Pixels beyond which a disc is another part than the keypoint's.
_FAR = 2.0


class PartLight(eqx.Module):
    """The light of the parts in front of a background z̄ that does not move, from keypoints x_tk that are near them.

    Parts that are soft discs are fitted as such (`fit_discs`): c_tk is the centre of a disc, a_tk its light. A trained
    network's keypoints are 0.02 to 0.15 pixels from the discs of the toy sets, which are 0.001 from the truth. Own
    parameters must be told by how five points bend, which this decides. Of other parts,

        w_tpk ∝ exp(−|x_p − x_tk|²/2s²),  Σ_k w_tpk = 1,  s = 0.1
        a_tk = Σ_p w_tpk (z_tp − z̄_p) / HW · 100,    c_tk = x_tk

    A sum over the pixels of a part knows its size a hundred times better than one pixel knows its value.

    Attributes:
        background: z̄ [H, W, 3], the most frequent value of each pixel; measured, not trained.
        discs: 1 where the parts are discs, otherwise 0; measured, not trained.
    """

    background: Float[Array, "H W 3"]
    discs: Float[Array, ""]

    @classmethod
    def unknown(cls, height: int, width: int) -> "PartLight":
        """Return that in front of grey, before it is measured; keypoints stay where they are."""
        return cls(jnp.full((height, width, 3), 0.5), jnp.zeros(()))

    def __call__(self, frames: Float[Array, "n H W 3"], keypoints: Float[Array, "n K 2"]) -> Float[Array, "K 4"]:
        """Return (log |a_k|, a_k / |a_k|) of each part: the size of its light, and the direction in colours.

        a_k is the mean of a_tk. A part of twice the area and the same colour adds twice the light: the logarithm makes
        one step of this, whatever the colour.

        Args:
            frames: z, values in [0, 1].
            keypoints: x, image-plane units.
        """
        light = jax.lax.cond(
            self.discs > 0,
            lambda: fit_discs(frames, self.background, keypoints).light,
            lambda: self._claimed(frames, keypoints),
        )
        a = jnp.mean(light, axis=0)
        size = jnp.sqrt(jnp.sum(a**2, axis=1, keepdims=True) + _DARK**2)
        return jnp.concatenate([jnp.log(size), a / size], axis=1)

    def moved(self, frames: Float[Array, "n H W 3"], keypoints: Float[Array, "n K 2"]) -> Float[Array, "n K 2"]:
        """Return c [n, K, 2], image-plane units: a keypoint more than 2 pixels from its disc stays where it is."""
        return jax.lax.cond(self.discs > 0, lambda: self._centres(frames, keypoints), lambda: keypoints)

    def _centres(self, frames: Array, keypoints: Array) -> Array:
        away = fit_discs(frames, self.background, keypoints).centres - keypoints
        near = jnp.sum(away**2, axis=-1, keepdims=True) < (_FAR * pixel_size(*self.background.shape[:2])) ** 2
        return keypoints + jax.lax.stop_gradient(jnp.where(near, away, 0.0))

    def _claimed(self, frames: Array, keypoints: Array) -> Array:
        """Return a [n, K, 3] of parts that are no discs."""
        height, width = self.background.shape[:2]
        away = image_grid(height, width).reshape(1, -1, 1, 2) - keypoints[:, None]
        near = jax.nn.softmax(-jnp.sum(away**2, axis=-1) / (2 * _REACH**2), axis=-1)
        added = (frames - self.background[None]).reshape(len(frames), -1, 3)
        return jnp.einsum("npk,npc->nkc", near, added, precision="highest") * (100 / (height * width))


def most_frequent(frames: UInt8[np.ndarray, "N H W 3"]) -> Float[np.ndarray, "H W 3"]:
    """Return the most frequent value of each pixel and channel, 0 to 1.

    Where soft discs often pass, the faint edges of one are in most frames: the median is off by up to two of 255
    values, which in many pixels far from a part moves the centre of its light by 0.02 pixels.
    """
    counts = np.stack([np.sum(frames == value, axis=0) for value in range(256)])
    return np.argmax(counts, axis=0) / 255.0
