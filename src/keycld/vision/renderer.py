"""From keypoints to a frame: Gaussian blobs and learned constant features through a U-Net."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from keycld.vision.coordinates import gaussian_maps, image_grid
from keycld.vision.layers import depth_to_space
from keycld.vision.unet import AbstractUNet


class AbstractRenderer(eqx.Module):
    """From keypoints to one frame.

    Renderers have a `background`: the mean frame of the training data, never trained, or None (the paper). They then
    add to the background's logit and start from a perfect still picture.
    """

    @property
    @abstractmethod
    def size(self) -> tuple[int, int]:
        """Height and width of the frames, pixels."""

    @abstractmethod
    def __call__(self, keypoints: Float[Array, "K 2"]) -> Float[Array, "H W 3"]:
        """Draws one frame with values in (0, 1)."""


class Renderer(AbstractRenderer):
    """The renderer of the paper (section 3, appendix A.4).

    Its input are constant feature maps, which it learns and which hold the still parts of the picture, and
    one Gaussian map a keypoint, eq. (9); its output passes a logistic function.

    - `network`: a U-Net from `features + K` channels to `3 · stride²`.
    - `features`: the learned constant maps `[H/stride, W/stride, features]`.
    - `background`: see `AbstractRenderer`.
    - `sigma`: width of the blobs in image-plane units; 0.1 in the paper.
    """

    network: AbstractUNet
    features: Float[Array, "rows columns features"]
    background: Float[Array, "H W 3"] | None
    stride: int = eqx.field(static=True)
    sigma: float = eqx.field(static=True)

    @property
    def size(self) -> tuple[int, int]:
        """Of the features, times the stride."""
        rows, columns, _ = self.features.shape
        return rows * self.stride, columns * self.stride

    def __call__(self, keypoints: Float[Array, "K 2"]) -> Float[Array, "H W 3"]:
        """Draws one frame with values in (0, 1)."""
        grid = image_grid(*self.size, self.stride)
        blobs = gaussian_maps(keypoints, grid, self.sigma)
        x = self.network(jnp.concatenate([self.features, blobs], axis=-1))
        return on_background(depth_to_space(x, self.stride), self.background)


def on_background(logits: Float[Array, "H W 3"], background: Float[Array, "H W 3"] | None) -> Float[Array, "H W 3"]:
    """A frame from logits, added to those of the background if there is one."""
    if background is not None:
        still = jnp.clip(jax.lax.stop_gradient(background), 0.002, 0.998)
        logits = logits + jnp.log(still) - jnp.log1p(-still)
    return jax.nn.sigmoid(logits)
