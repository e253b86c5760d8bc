"""From a frame to keypoints: heat maps of a U-Net through a spatial softmax."""

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
import jax
from jaxtyping import Array, Float

from keycld.vision.coordinates import image_grid, spatial_softmax
from keycld.vision.layers import space_to_depth
from keycld.vision.unet import AbstractUNet


class Observation(NamedTuple):
    """What an observer sees in one frame.

    - `keypoints`: positions in image-plane units `[K, 2]`.
    - `heat_maps`: probability of each keypoint over the image `[K, rows, columns]`; each map sums to one. None for
      an observer without maps.
    """

    keypoints: Float[Array, "K 2"]
    heat_maps: Float[Array, "K rows columns"] | None


class Standardise(eqx.Module):
    """(frame − mean frame) / deviation; both are statistics of the training data, never trained.

    What never moves becomes zero, so that the first gradients already speak of what does.
    """

    mean: Float[Array, "H W 3"]
    deviation: Float[Array, ""]

    def __call__(self, frame: Float[Array, "H W 3"]) -> Float[Array, "H W 3"]:
        """Standardises one frame."""
        mean, deviation = jax.lax.stop_gradient((self.mean, self.deviation))
        return (frame - mean) / deviation


class AbstractEstimator(eqx.Module):
    """From one frame to keypoints. Estimators `standardise` it by statistics of the data, or take it as it is."""

    @abstractmethod
    def __call__(self, frame: Float[Array, "H W 3"]) -> Observation:
        """Finds the keypoints of one frame with values in [0, 1]."""


class KeypointEstimator(AbstractEstimator):
    """The observer of the paper (section 3, appendix A.4): one heat map a keypoint, then eq. (8).

    - `network`: a U-Net from `3 · stride²` channels to K logit maps.
    - `standardise`: statistics of the data, or None for frames as they are (the paper).
    - `stride`: pixels a cell of the heat map has on a side. With 2, each 2×2 patch becomes twelve channels,
      so nothing is lost and the network does a quarter of the work; the expectation (8) stays sub-pixel.
    """

    network: AbstractUNet
    standardise: Standardise | None
    stride: int = eqx.field(static=True)

    def __call__(self, frame: Float[Array, "H W 3"]) -> Observation:
        """Finds the keypoints of one frame with values in [0, 1]."""
        return self.locate(self.logits(frame))

    def logits(self, frame: Float[Array, "H W 3"]) -> Float[Array, "rows columns K"]:
        """The network's maps before the softmax."""
        x = frame if self.standardise is None else self.standardise(frame)
        return self.network(space_to_depth(x, self.stride))

    def locate(self, logits: Float[Array, "rows columns K"]) -> Observation:
        """Softmax and expectation, eq. (8)."""
        rows, columns, _ = logits.shape
        grid = image_grid(rows * self.stride, columns * self.stride, self.stride)
        keypoints, maps = spatial_softmax(logits, grid)
        return Observation(keypoints, maps.transpose(2, 0, 1))
