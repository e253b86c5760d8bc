"""Convolutional layers, channels last, on one example `[H, W, C]`.

They compute what the usual layers compute. Where XLA's own form is slow on a CPU (max-pooling's gradient, the
nearest-neighbour resize), an equal and faster form is used.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics import lecun_normal
from keycld.vision.convolution import convolve, convolve_doubled


class Conv(eqx.Module):
    """A convolution with square kernel and zero padding that keeps the size, or with a stride divides it.

    Biases are zero at first. Kernels are by default from N(0, 1/fan_in) truncated at two deviations and scaled to that
    variance again (Flax's default, which the networks of KeyCLD use).
    """

    kernel: Float[Array, "size size inputs outputs"]
    bias: Float[Array, " outputs"]
    stride: int = eqx.field(static=True)

    def __init__(
        self,
        inputs: int,
        outputs: int,
        size: int = 3,
        stride: int = 1,
        initialise: Callable[[PRNGKeyArray, tuple[int, int]], Array] = lecun_normal,
        *,
        key: PRNGKeyArray,
    ):
        """Sample the kernel.

        Args:
            inputs: channels.
            outputs: channels.
            size: side of the kernel, pixels.
            stride: pixels between outputs.
            initialise: gives a kernel as a matrix [fan_in, outputs].
            key: for it.
        """
        # A matrix compiles three times faster than a kernel; the numbers are the same.
        flat = initialise(key, (size * size * inputs, outputs))
        self.kernel = flat.reshape(size, size, inputs, outputs)
        self.bias = jnp.zeros(outputs)
        self.stride = stride

    def __call__(self, x: Float[Array, "h w inputs"]) -> Float[Array, "h2 w2 outputs"]:
        """Convolve one example."""
        y = convolve(x[None], self.kernel.astype(x.dtype), self.stride)[0]
        return y + self.bias.astype(x.dtype)[None, None, :]

    def doubled(self, x: Float[Array, "h w inputs"]) -> Float[Array, "h2 w2 outputs"]:
        """Convolve `upsample(x)` with a 3×3 kernel of stride 1."""
        y = convolve_doubled(x[None], self.kernel.astype(x.dtype))[0]
        return y + self.bias.astype(x.dtype)[None, None, :]


class GroupNorm(eqx.Module):
    """Group normalisation over height, width and the channels of a group (eight groups in the paper)."""

    scale: Float[Array, " channels"]
    offset: Float[Array, " channels"]
    groups: int = eqx.field(static=True)

    def __init__(self, channels: int, groups: int = 8):
        self.scale = jnp.ones(channels)
        self.offset = jnp.zeros(channels)
        self.groups = groups

    def __call__(self, x: Float[Array, "h w channels"]) -> Float[Array, "h w channels"]:
        """Normalise one example; ε = 1e-6 as in Flax."""
        # Means per channel first: they reduce the large axes once, and the groups are then a few numbers.
        mean = self._pool(jnp.mean(x, (0, 1)))
        square = self._pool(jnp.mean(x * x, (0, 1)))
        gain = self.scale * jax.lax.rsqrt(jnp.maximum(square - mean * mean, 0.0) + 1e-6)
        return x * gain[None, None, :] + (self.offset - mean * gain)[None, None, :]

    def _pool(self, per_channel: Float[Array, " channels"]) -> Float[Array, " channels"]:
        groups = jnp.mean(per_channel.reshape(self.groups, -1), axis=1)
        return jnp.repeat(groups, per_channel.shape[0] // self.groups)


class Block(eqx.Module):
    """3×3 convolution, group normalisation, ReLU: the paper's building block (appendix A.4)."""

    conv: Conv
    norm: GroupNorm

    def __init__(self, inputs: int, outputs: int, *, key: PRNGKeyArray):
        self.conv = Conv(inputs, outputs, key=key)
        self.norm = GroupNorm(outputs)

    def __call__(self, x: Float[Array, "h w inputs"]) -> Float[Array, "h w outputs"]:
        """Apply the block to one example."""
        return jax.nn.relu(self.norm(self.conv(x)))


def max_pool(x: Float[Array, "h w c"]) -> Float[Array, "h2 w2 c"]:
    """Apply 2×2 max-pooling."""
    # Not `jnp.max`: its gradient divides by the number of values that equal the largest, which is none where XLA has
    # computed x a second time and rounded it differently.
    h, w, c = x.shape
    pairs = x.reshape(h // 2, 2, w // 2, 2, c)
    rows = jnp.maximum(pairs[:, 0], pairs[:, 1])
    return jnp.maximum(rows[:, :, 0], rows[:, :, 1])


def upsample(x: Float[Array, "h w c"]) -> Float[Array, "h2 w2 c"]:
    """Upsample by two, nearest neighbour."""
    return jnp.repeat(jnp.repeat(x, 2, axis=0), 2, axis=1)


def space_to_depth(x: Float[Array, "h w c"], factor: int) -> Float[Array, "h2 w2 c2"]:
    """Move each `factor × factor` patch of pixels into the channels; nothing is lost."""
    h, w, c = x.shape
    x = x.reshape(h // factor, factor, w // factor, factor, c)
    return x.transpose(0, 2, 1, 3, 4).reshape(h // factor, w // factor, factor * factor * c)


def depth_to_space(x: Float[Array, "h w c"], factor: int) -> Float[Array, "h2 w2 c2"]:
    """Undo `space_to_depth`."""
    h, w, c = x.shape
    x = x.reshape(h, w, factor, factor, c // factor**2).transpose(0, 2, 1, 3, 4)
    return x.reshape(h * factor, w * factor, c // factor**2)
