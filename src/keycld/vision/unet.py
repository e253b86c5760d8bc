"""Two U-Nets: the paper's, and a light one for CPUs."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from keycld.vision.layers import Block, Conv, max_pool, upsample


class AbstractUNet(eqx.Module):
    """Maps `[h, w, inputs]` to `[h, w, outputs]`; height and width must be multiples of four."""

    down: eqx.AbstractVar[tuple[Block, Block, Block]]
    out: eqx.AbstractVar[Conv]

    @abstractmethod
    def __call__(self, x: Float[Array, "h w inputs"]) -> Float[Array, "h w outputs"]:
        """Apply the network to one example."""

    def with_inputs(self, order: Int[Array, " inputs"]) -> "AbstractUNet":
        """Return the network whose input k is treated as input `order[k]` was."""
        return eqx.tree_at(lambda net: net.down[0].conv.kernel, self, self.down[0].conv.kernel[:, :, order])

    def with_outputs(self, order: Int[Array, " outputs"]) -> "AbstractUNet":
        """Return the network whose output k is what output `order[k]` was."""
        kernel, bias = self.out.kernel[..., order], self.out.bias[order]
        return eqx.tree_at(lambda net: (net.out.kernel, net.out.bias), self, (kernel, bias))


class PaperUNet(AbstractUNet):
    """The network of appendix A.4: widths 1-2-4-2-1 × `width`, two max-pools, skips by concatenation."""

    down: tuple[Block, Block, Block]
    up: tuple[Block, Block]
    out: Conv

    def __init__(self, inputs: int, outputs: int, width: int = 32, *, key: PRNGKeyArray):
        keys = jax.random.split(key, 6)
        self.down = (
            Block(inputs, width, key=keys[0]),
            Block(width, 2 * width, key=keys[1]),
            Block(2 * width, 4 * width, key=keys[2]),
        )
        self.up = (Block(6 * width, 2 * width, key=keys[3]), Block(3 * width, width, key=keys[4]))
        self.out = Conv(width, outputs, key=keys[5])

    def __call__(self, x: Float[Array, "h w inputs"]) -> Float[Array, "h w outputs"]:
        """Apply the network to one example."""
        fine = self.down[0](x)
        middle = self.down[1](max_pool(fine))
        coarse = self.down[2](max_pool(middle))
        middle = self.up[0](jnp.concatenate([upsample(coarse), middle], axis=-1))
        fine = self.up[1](jnp.concatenate([upsample(middle), fine], axis=-1))
        return self.out(fine)


class LightUNet(AbstractUNet):
    """A U-Net of the same depth with skips by addition: half of the arithmetic at equal width.

    In the paper's network most of the work is in the two convolutions after the concatenations. Here a 1×1 convolution
    reduces the coarse features to the width of the finer ones before upsampling, and the two are added.
    """

    down: tuple[Block, Block, Block]
    narrow: tuple[Conv, Conv]
    up: tuple[Block, Block]
    out: Conv

    def __init__(self, inputs: int, outputs: int, width: int = 24, *, key: PRNGKeyArray):
        keys = jax.random.split(key, 8)
        self.down = (
            Block(inputs, width, key=keys[0]),
            Block(width, 2 * width, key=keys[1]),
            Block(2 * width, 4 * width, key=keys[2]),
        )
        self.narrow = (
            Conv(4 * width, 2 * width, size=1, key=keys[3]),
            Conv(2 * width, width, size=1, key=keys[4]),
        )
        self.up = (Block(2 * width, 2 * width, key=keys[5]), Block(width, width, key=keys[6]))
        # Small initial outputs: flat heat maps, and a renderer that gives its background.
        out = Conv(width, outputs, key=keys[7])
        self.out = eqx.tree_at(lambda conv: conv.kernel, out, 0.1 * out.kernel)

    def __call__(self, x: Float[Array, "h w inputs"]) -> Float[Array, "h w outputs"]:
        """Apply the network to one example."""
        fine = self.down[0](x)
        middle = self.down[1](max_pool(fine))
        coarse = self.down[2](max_pool(middle))
        middle = self.up[0](upsample(self.narrow[0](coarse)) + middle)
        fine = self.up[1](upsample(self.narrow[1](middle)) + fine)
        return self.out(fine)
