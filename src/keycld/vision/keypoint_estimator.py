"""From a frame to keypoints: a U-Net gives heat maps, a spatial softmax gives positions."""

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from keycld.vision.coordinates import image_grid, spatial_softmax
from keycld.vision.layers import space_to_depth
from keycld.vision.unet import AbstractUNet


class Observation(NamedTuple):
    """What an estimator finds in one frame.

    Attributes:
        keypoints: positions, image-plane units.
        heat_maps: the probability of each keypoint over the image; each map sums to one. None for an estimator without
            maps.
        looks: numbers that describe how each part looks, such as its colour; None where all recordings look the same.
    """

    keypoints: Float[Array, "K 2"]
    heat_maps: Float[Array, "K rows columns"] | None
    looks: Float[Array, "K D"] | None = None


class Standardise(eqx.Module):
    """(frame − mean frame) / deviation.

    Pixels that never change become zero, so that the first gradients already come from what moves.

    Attributes:
        mean: mean frame of the training data; not trained.
        deviation: standard deviation of the training pixels from it; not trained.
    """

    mean: Float[Array, "H W 3"]
    deviation: Float[Array, ""]

    def __call__(self, frame: Float[Array, "H W 3"]) -> Float[Array, "H W 3"]:
        """Standardise one frame."""
        mean, deviation = jax.lax.stop_gradient((self.mean, self.deviation))
        return (frame - mean) / deviation


class AbstractEstimator(eqx.Module):
    """From one frame to keypoints."""

    @abstractmethod
    def __call__(self, frame: Float[Array, "H W 3"]) -> Observation:
        """Estimate the keypoints of one frame with values in [0, 1]."""

    @abstractmethod
    def reordered(self, order: Int[Array, " K"]) -> "AbstractEstimator":
        """Return the estimator whose keypoint k is what keypoint `order[k]` was."""


class KeypointEstimator(AbstractEstimator):
    """The keypoint estimator of the paper (section 3, appendix A.4): one heat map for each keypoint, then eq. (8).

    Where the parts look different in each recording, D more maps f describe the look of what is at each cell p. The
    look of keypoint k with the heat map s_k is Σ_p s_k(p) tanh f(p). Ours; the paper has none.

    Attributes:
        network: a U-Net from `3 · stride²` channels to K logit maps, and D maps of looks.
        standardise: applied to the frame first; None for frames as they are (the paper).
        stride: side of a heat-map cell in pixels. With 2, each 2×2 patch becomes twelve channels: no information is
            lost, the network does a quarter of the work, and the expectation of eq. (8) stays sub-pixel.
        looks: D; 0: all recordings look the same.
    """

    network: AbstractUNet
    standardise: Standardise | None
    stride: int = eqx.field(static=True)
    looks: int = eqx.field(static=True, default=0)

    def __call__(self, frame: Float[Array, "H W 3"]) -> Observation:
        """Estimate the keypoints of one frame with values in [0, 1]."""
        return self.locate(self.logits(frame))

    def reordered(self, order: Int[Array, " K"]) -> "AbstractEstimator":
        """Return the estimator whose keypoint k is what keypoint `order[k]` was."""
        outputs = jnp.concatenate([order, len(order) + jnp.arange(self.looks)])
        return eqx.tree_at(lambda e: e.network, self, self.network.with_outputs(outputs))

    def logits(self, frame: Float[Array, "H W 3"]) -> Float[Array, "rows columns maps"]:
        """Return the K maps before the softmax, then those of looks before the tanh."""
        x = frame if self.standardise is None else self.standardise(frame)
        return self.network(space_to_depth(x, self.stride))

    def locate(self, logits: Float[Array, "rows columns maps"]) -> Observation:
        """Return the keypoints, heat maps and looks of some logits, eq. (8)."""
        rows, columns, count = logits.shape
        grid = image_grid(rows * self.stride, columns * self.stride, self.stride)
        keypoints, maps = spatial_softmax(logits[..., : count - self.looks], grid)
        looks = None
        if self.looks:
            looks = jnp.einsum("rck,rcd->kd", maps, jnp.tanh(logits[..., count - self.looks :]))
        return Observation(keypoints, maps.transpose(2, 0, 1), looks)
