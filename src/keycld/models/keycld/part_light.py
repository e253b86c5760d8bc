"""What the parts add to a still background: how much light, of which colour, and where its centre is."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from keycld.vision import image_grid

# s of the shares of parts in a pixel.
_REACH = 0.1
# Less light than this, per cent of a white picture, has no direction and no centre.
_DARK = 1e-4


class PartLight(eqx.Module):
    """The light of the parts in front of a background z̄ that does not move, from keypoints x_tk that are near them.

        w_tpk ∝ exp(−|x_p − x_tk|²/2s²),  Σ_k w_tpk = 1,  s = 0.1
        a_tk = Σ_p w_tpk (z_tp − z̄_p) / HW · 100,    d_tk = a_tk / |a_tk|

    A sum over the pixels of a part knows its size a hundred times better than one pixel knows its value. So does the
    centre of the light know where the part is:

        c_tk = Σ_p w_tpk (z_tp − z̄_p)·d_tk x_p / Σ_p w_tpk (z_tp − z̄_p)·d_tk

    Of a soft disc in 32 × 32 pixels with 256 values it is 0.0014 pixels from the middle. Errors of a trained network's
    keypoints, as `roughness` shows them, are 0.002 to 0.014 pixels on the toy sets. Own parameters must be told by how
    five points bend, which this decides.

    Attributes:
        background: z̄ [H, W, 3], the most frequent value of each pixel; measured, not trained.
        centred: 1 where keypoints are moved to the centres, otherwise 0; measured, not trained.
    """

    background: Float[Array, "H W 3"]
    centred: Float[Array, ""]

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
        a = jnp.mean(jnp.sum(self._shares(frames, keypoints), axis=1), axis=0)
        size = jnp.sqrt(jnp.sum(a**2, axis=1, keepdims=True) + _DARK**2)
        return jnp.concatenate([jnp.log(size), a / size], axis=1)

    def centres(self, frames: Float[Array, "n H W 3"], keypoints: Float[Array, "n K 2"]) -> Float[Array, "n K 2"]:
        """Return c [n, K, 2], image-plane units; a part without light stays at its keypoint."""
        shares = self._shares(frames, keypoints)
        a = jnp.sum(shares, axis=1)
        size = jnp.sqrt(jnp.sum(a**2, axis=-1) + _DARK**2)
        along = jnp.einsum("tpkc,tkc->tpk", shares, a / size[..., None], precision="highest")
        away = image_grid(*self.background.shape[:2]).reshape(1, -1, 1, 2) - keypoints[:, None]
        return keypoints + jnp.einsum("tpk,tpkd->tkd", along, away, precision="highest") / size[..., None]

    def moved(self, frames: Float[Array, "n H W 3"], keypoints: Float[Array, "n K 2"]) -> Float[Array, "n K 2"]:
        """Return the keypoints, at the centres if `centred`."""
        return keypoints + self.centred * (self.centres(frames, keypoints) - keypoints)

    def _shares(self, frames: Array, keypoints: Array) -> Array:
        """Return w (z − z̄) / HW · 100, [n, HW, K, 3]."""
        height, width = self.background.shape[:2]
        away = image_grid(height, width).reshape(1, -1, 1, 2) - keypoints[:, None]
        near = jax.nn.softmax(-jnp.sum(away**2, axis=-1) / (2 * _REACH**2), axis=-1)
        added = (frames - self.background[None]).reshape(len(frames), -1, 1, 3)
        return near[..., None] * added * (100 / (height * width))


def most_frequent(frames: UInt8[np.ndarray, "N H W 3"]) -> Float[np.ndarray, "H W 3"]:
    """Return the most frequent value of each pixel and channel, 0 to 1.

    Where soft discs often pass, the faint edges of one are in most frames: the median is off by up to two of 255
    values, which in many pixels far from a part moves the centre of its light by 0.02 pixels.
    """
    counts = np.stack([np.sum(frames == value, axis=0) for value in range(256)])
    return np.argmax(counts, axis=0) / 255.0


def roughness(x: Any) -> float:
    """Return the deviation of independent errors that fourth differences of tracks `[N, T, dim]` show.

    Those of a smooth motion are small, and errors of variance σ² give them (1 + 16 + 36 + 16 + 1) σ² = 70 σ². The
    median over recordings does not mind a few that jump.
    """
    fourth = np.diff(np.asarray(x, float), n=4, axis=1)
    return float(np.sqrt(np.median(np.mean(fourth**2, axis=(1, 2))) / 70))
