"""From keypoints to a frame: Gaussian blobs and learned constant features through a U-Net."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from keycld.vision.coordinates import gaussian_maps, image_grid
from keycld.vision.layers import depth_to_space
from keycld.vision.unet import AbstractUNet


class AbstractRenderer(eqx.Module):
    """From keypoints to one frame.

    A renderer may have a `background`, the mean frame of the training data, which is not trained. It then adds to the
    logit of the background, so that training begins at the mean frame. The paper's renderer has none.
    """

    @property
    @abstractmethod
    def size(self) -> tuple[int, int]:
        """Height and width of the frames, pixels."""

    @abstractmethod
    def __call__(
        self, keypoints: Float[Array, "K 2"], looks: Float[Array, "K D"] | None = None
    ) -> Float[Array, "H W 3"]:
        """Render one frame with values in (0, 1), of parts with these looks where they differ between recordings."""

    @abstractmethod
    def reordered(self, order: Int[Array, " K"]) -> "AbstractRenderer":
        """Return the renderer that treats keypoint k as keypoint `order[k]` was."""


class Renderer(AbstractRenderer):
    """The renderer of the paper (section 3, appendix A.4).

    The network's input is one Gaussian map for each keypoint, eq. (9), and constant feature maps. These are learned and
    describe the parts of the image that do not move. Where the parts look different in each recording, there is also
    the map of each keypoint times each of the D numbers of its look. The output passes a logistic function.

    Attributes:
        network: a U-Net from `features + K (1 + D)` channels to `3 · stride²`.
        features: the learned constant maps.
        background: see `AbstractRenderer`.
        stride: side of a cell in pixels.
        sigma: width of the Gaussian maps, image-plane units; 0.1 in the paper.
    """

    network: AbstractUNet
    features: Float[Array, "rows columns features"]
    background: Float[Array, "H W 3"] | None
    stride: int = eqx.field(static=True)
    sigma: float = eqx.field(static=True)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the frames, pixels."""
        rows, columns, _ = self.features.shape
        return rows * self.stride, columns * self.stride

    def __call__(
        self, keypoints: Float[Array, "K 2"], looks: Float[Array, "K D"] | None = None
    ) -> Float[Array, "H W 3"]:
        """Render one frame with values in (0, 1)."""
        grid = image_grid(*self.size, self.stride)
        blobs = gaussian_maps(keypoints, grid, self.sigma)
        maps = [self.features, blobs]
        if looks is not None:
            maps.append((blobs[..., None] * looks[None, None]).reshape(*blobs.shape[:2], -1))
        x = self.network(jnp.concatenate(maps, axis=-1))
        return on_background(depth_to_space(x, self.stride), self.background)

    def reordered(self, order: Int[Array, " K"]) -> "AbstractRenderer":
        """Return the renderer that treats keypoint k as keypoint `order[k]` was."""
        features, count = self.features.shape[-1], len(order)
        looks = (self.network.down[0].conv.kernel.shape[2] - features - count) // count
        of_looks = count + (looks * order[:, None] + jnp.arange(looks)[None, :]).reshape(-1)
        inputs = jnp.concatenate([jnp.arange(features), features + order, features + of_looks])
        return eqx.tree_at(lambda r: r.network, self, self.network.with_inputs(inputs))


def on_background(logits: Float[Array, "H W 3"], background: Float[Array, "H W 3"] | None) -> Float[Array, "H W 3"]:
    """Return the frame of some logits, added to those of the background if there is one."""
    if background is not None:
        still = jnp.clip(jax.lax.stop_gradient(background), 0.002, 0.998)
        logits = logits + jnp.log(still) - jnp.log1p(-still)
    return jax.nn.sigmoid(logits)
