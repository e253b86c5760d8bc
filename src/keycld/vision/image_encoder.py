"""From an image to numbers without places: the encoder of "Which priors matter?"."""

import equinox as eqx
import jax
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics import Linear, truncated_normal
from keycld.vision.fully_connected import halvings_to_four
from keycld.vision.layers import Conv


class ImageEncoder(eqx.Module):
    """Convolutions down to 4×4 cells, then a dense layer.

    One block halves the picture: a 3×3 convolution of stride 2 and one of stride 1. Three blocks at 32×32 pixels, four
    at 64×64. The last block has a third convolution, to as many channels as there are outputs. Leaky ReLU (slope 0.01)
    after each convolution but the last; no normalisation.

    Attributes:
        convolutions: in the order of application.
        out: the dense layer.
        size: height and width of the pictures, pixels.
    """

    convolutions: tuple[Conv, ...]
    out: Linear
    size: tuple[int, int] = eqx.field(static=True)

    def __init__(self, size: tuple[int, int], inputs: int, outputs: int, channels: int = 64, *, key: PRNGKeyArray):
        """Build the layers.

        Args:
            size: height and width of the pictures, pixels.
            inputs: channels of the pictures; three for each of several stacked frames.
            outputs: numbers that an image becomes.
            channels: of the convolutions.
            key: of the random kernels.

        Raises:
            KeycldError: for a size that cannot be halved down to 4 cells.
        """
        halvings, (rows, columns) = halvings_to_four(size, 1)
        *keys, last = jax.random.split(key, 2 * halvings + 2)
        widths = [inputs, *[channels] * (2 * halvings), outputs]
        strides = [*[2, 1] * halvings, 1]
        self.convolutions = tuple(
            Conv(a, b, 3, stride, truncated_normal, key=k)
            for a, b, stride, k in zip(widths[:-1], widths[1:], strides, keys, strict=True)
        )
        self.out = Linear(rows * columns * outputs, outputs, key=last)
        self.size = size

    def __call__(self, image: Float[Array, "H W inputs"]) -> Float[Array, "outputs"]:
        """Encode one image, or several frames stacked along its channels."""
        x = image
        for convolution in self.convolutions[:-1]:
            x = jax.nn.leaky_relu(convolution(x))
        return self.out(self.convolutions[-1](x).reshape(-1))
