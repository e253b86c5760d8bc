"""From numbers without places to an image: the decoder of "Which priors matter?"."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics import Linear, truncated_normal
from keycld.vision.fully_connected import halvings_to_four
from keycld.vision.layers import Conv


class ImageDecoder(eqx.Module):
    """A dense layer to 4×4 cells, then upsampling and convolutions.

    Two learned constant maps stand in front of the cells' channels. One block doubles the picture: nearest-neighbour
    upsampling and two 3×3 convolutions, of which the last block has a third one, to the three colours. Three blocks at
    32×32 pixels, four at 64×64. Leaky ReLU after each convolution but the last, then a logistic function.

    Attributes:
        cells: the dense layer; None where the numbers are the channels of the cells already.
        constants: the learned maps, one at first.
        convolutions: in the order of application.
        coarse: rows and columns of the cells.
        slope: of the leaky ReLU for negative numbers.
    """

    cells: Linear | None
    constants: Float[Array, "rows columns 2"]
    convolutions: tuple[Conv, ...]
    coarse: tuple[int, int] = eqx.field(static=True)
    slope: float = eqx.field(static=True)

    def __init__(
        self,
        size: tuple[int, int],
        inputs: int,
        features: int,
        channels: int = 64,
        *,
        dense: bool = True,
        taper: bool = False,
        slope: float = 0.01,
        key: PRNGKeyArray,
    ):
        """Build the layers.

        Args:
            size: height and width of the pictures, pixels.
            inputs: numbers that become an image.
            features: channels of the cells; 16 in the paper.
            channels: of the convolutions.
            dense: whether there is a dense layer; without it, `inputs` are the cells' channels.
            taper: whether each block after the first has half the channels of the one before it.
            slope: of the leaky ReLU for negative numbers.
            key: of the random kernels.

        Raises:
            KeycldError: for a size that cannot be halved down to 4 cells.
        """
        halvings, self.coarse = halvings_to_four(size, 1)
        first, *keys = jax.random.split(key, 2 * halvings + 2)
        rows, columns = self.coarse
        self.cells = Linear(inputs, rows * columns * features, key=first) if dense else None
        self.constants = jnp.ones((rows, columns, 2))
        blocks = [max(1, channels >> k) if taper else channels for k in range(halvings)]
        widths = [features + 2, *(width for width in blocks for _ in range(2)), 3]
        self.convolutions = tuple(
            Conv(a, b, 3, 1, truncated_normal, key=k) for a, b, k in zip(widths[:-1], widths[1:], keys, strict=True)
        )
        self.slope = slope

    def __call__(self, x: Float[Array, "inputs"]) -> Float[Array, "H W 3"]:
        """Render one picture with values in (0, 1)."""
        return jax.nn.sigmoid(self.logits(x))

    def logits(self, x: Float[Array, "inputs"]) -> Float[Array, "H W 3"]:
        """Return what the logistic function maps to the values of a picture."""
        cells = x if self.cells is None else self.cells(x)
        y = jnp.concatenate([self.constants, cells.reshape(*self.coarse, -1)], axis=-1)
        for k, convolution in enumerate(self.convolutions[:-1]):
            y = jax.nn.leaky_relu(convolution(y) if k % 2 else convolution.doubled(y), self.slope)
        return self.convolutions[-1](y)
