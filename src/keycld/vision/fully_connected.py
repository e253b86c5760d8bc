"""Estimator and renderer with dense layers instead of heat maps: the ablation FC (appendix A.4)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from keycld._errors import KeycldError
from keycld.vision.keypoint_estimator import AbstractEstimator, Observation, Standardise
from keycld.vision.layers import Block, Conv, depth_to_space, max_pool, space_to_depth, upsample
from keycld.vision.renderer import AbstractRenderer, on_background

_COARSEST = 4


class DenseEstimator(AbstractEstimator):
    """Convolution blocks and max-pools down to 4×4 cells, then dense layers 256 and 2K.

    The "keypoints" are any 2K numbers: nothing ties them to positions in the image, and there are no heat maps.

    Attributes:
        blocks: widths `width`, 2 `width`, 4 `width`, …; as many blocks as halve the shorter side down to four cells.
        hidden: the dense layer of 256 units.
        out: the dense layer of 2K units.
        standardise: as in `KeypointEstimator`.
        stride: as in `KeypointEstimator`.
    """

    blocks: tuple[Block, ...]
    hidden: eqx.nn.Linear
    out: eqx.nn.Linear
    standardise: Standardise | None
    stride: int = eqx.field(static=True)

    def __init__(
        self,
        size: tuple[int, int],
        keypoints: int,
        width: int,
        standardise: Standardise | None,
        stride: int,
        *,
        key: PRNGKeyArray,
    ):
        halvings, coarse = halvings_to_four(size, stride)
        keys = jax.random.split(key, halvings + 2)
        widths = [3 * stride**2, *(width * 2**k for k in range(halvings))]
        self.blocks = tuple(
            Block(a, b, key=k) for a, b, k in zip(widths[:-1], widths[1:], keys[:halvings], strict=True)
        )
        self.hidden = eqx.nn.Linear(coarse[0] * coarse[1] * widths[-1], 256, key=keys[-2])
        self.out = eqx.nn.Linear(256, 2 * keypoints, key=keys[-1])
        self.standardise = standardise
        self.stride = stride

    def __call__(self, frame: Float[Array, "H W 3"]) -> Observation:
        """Estimate the coordinates of one frame with values in [0, 1]."""
        x = frame if self.standardise is None else self.standardise(frame)
        x = space_to_depth(x, self.stride)
        for block in self.blocks:
            x = max_pool(block(x))
        x = self.out(jax.nn.relu(self.hidden(x.reshape(-1))))
        return Observation(x.reshape(-1, 2), None)

    def reordered(self, order: Int[Array, " K"]) -> AbstractEstimator:
        """Return the estimator whose keypoint k is what keypoint `order[k]` was."""
        rows = _components(order)
        assert self.out.bias is not None
        return eqx.tree_at(lambda e: (e.out.weight, e.out.bias), self, (self.out.weight[rows], self.out.bias[rows]))


class DenseRenderer(AbstractRenderer):
    """Dense layers 256 and 4×4 cells, then convolution blocks and upsampling back to the size of the frame.

    Attributes:
        hidden: the dense layer of 256 units.
        cells: the dense layer that gives the coarse cells.
        blocks: those of `DenseEstimator` in reverse order.
        out: the last convolution.
        background: as in `AbstractRenderer`.
        coarse: rows and columns of coarse cells.
        stride: as in `Renderer`.
    """

    hidden: eqx.nn.Linear
    cells: eqx.nn.Linear
    blocks: tuple[Block, ...]
    out: Conv
    background: Float[Array, "H W 3"] | None
    coarse: tuple[int, int] = eqx.field(static=True)
    stride: int = eqx.field(static=True)

    def __init__(
        self,
        size: tuple[int, int],
        keypoints: int,
        width: int,
        background: Float[Array, "H W 3"] | None,
        stride: int,
        *,
        key: PRNGKeyArray,
    ):
        halvings, self.coarse = halvings_to_four(size, stride)
        keys = jax.random.split(key, halvings + 3)
        widths = [width * 2**k for k in reversed(range(halvings))]
        self.hidden = eqx.nn.Linear(2 * keypoints, 256, key=keys[-3])
        self.cells = eqx.nn.Linear(256, self.coarse[0] * self.coarse[1] * widths[0], key=keys[-2])
        self.blocks = tuple(
            Block(a, b, key=k) for a, b, k in zip([widths[0], *widths[:-1]], widths, keys[:halvings], strict=True)
        )
        self.out = Conv(width, 3 * stride**2, key=keys[-1])
        self.background = background
        self.stride = stride

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the frames, pixels."""
        rows, columns = self.coarse
        scale = self.stride * 2 ** len(self.blocks)
        return rows * scale, columns * scale

    def __call__(
        self, keypoints: Float[Array, "K 2"], looks: Float[Array, "K D"] | None = None
    ) -> Float[Array, "H W 3"]:
        """Render one frame with values in (0, 1); it knows no looks."""
        assert looks is None
        x = self.cells(jax.nn.relu(self.hidden(keypoints.reshape(-1))))
        x = x.reshape(*self.coarse, -1)
        for block in self.blocks:
            x = upsample(block(x))
        return on_background(depth_to_space(self.out(x), self.stride), self.background)

    def reordered(self, order: Int[Array, " K"]) -> AbstractRenderer:
        """Return the renderer that treats keypoint k as keypoint `order[k]` was."""
        return eqx.tree_at(lambda r: r.hidden.weight, self, self.hidden.weight[:, _components(order)])


def _components(order: Int[Array, " K"]) -> Int[Array, "2*K"]:
    return (2 * order[:, None] + jnp.arange(2)[None, :]).reshape(-1)


def halvings_to_four(size: tuple[int, int], stride: int) -> tuple[int, tuple[int, int]]:
    """Return how often an image at `1 / stride` resolution is halved, and its rows and columns of cells after that.

    The shorter side then has four cells.

    Raises:
        KeycldError: the sides of the image cannot be halved so often, or are too short.
    """
    rows, columns = size[0] // stride, size[1] // stride
    halvings = 0
    while min(rows, columns) // 2**halvings > _COARSEST:
        halvings += 1
    if halvings == 0 or any(side % (stride * 2**halvings) for side in size):
        raise KeycldError(
            f"networks that halve a picture down to {_COARSEST} cells take sides that are multiples of "
            f"{stride * 2 ** max(halvings, 1)} pixels and longer than {_COARSEST * stride}, not {size[0]}×{size[1]}: "
            "resize the pictures."
        )
    return halvings, (rows // 2**halvings, columns // 2**halvings)
