"""Networks on maps of 4×4 cells: those of the original HGN, in which a state is a picture of its own.

A map is passed on flat, rows × columns × channels numbers, so that a state is a vector for every model.
"""

from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from keycld.mechanics import truncated_normal
from keycld.vision.fully_connected import halvings_to_four
from keycld.vision.layers import Conv


class MapEncoder(eqx.Module):
    """Convolutions from stacked frames to two maps of 4×4 cells: mean and log deviation of each number.

    One block halves the picture: a 2×2 convolution of stride 2 and a 4×4 one of stride 1, ReLU after each convolution
    but the last. Three blocks at 32×32 pixels, four at 64×64.

    Attributes:
        convolutions: in the order of application.
        size: height and width of the pictures, pixels.
    """

    convolutions: tuple[Conv, ...]
    size: tuple[int, int] = eqx.field(static=True)

    def __init__(self, size: tuple[int, int], inputs: int, maps: int, channels: int = 64, *, key: PRNGKeyArray):
        """Build the layers.

        Args:
            size: height and width of the pictures, pixels.
            inputs: channels of the stacked frames.
            maps: numbers of a cell that have a mean and a deviation.
            channels: of the convolutions; the first has half of them.
            key: of the random kernels.

        Raises:
            KeycldError: for a size that cannot be halved down to 4 cells.
        """
        halvings, _ = halvings_to_four(size, 1)
        widths = [inputs, channels // 2, *[channels] * (2 * halvings - 2), 2 * maps]
        keys = jax.random.split(key, 2 * halvings)
        self.convolutions = tuple(
            Conv(a, b, *kernel, truncated_normal, key=k)
            for (a, b), kernel, k in zip(pairwise(widths), [(2, 2), (4, 1)] * halvings, keys, strict=True)
        )
        self.size = size

    def __call__(self, image: Float[Array, "H W inputs"]) -> Float[Array, "outputs"]:
        """Encode stacked frames: all means, then all log deviations."""
        x = image
        for convolution in self.convolutions[:-1]:
            x = jax.nn.relu(convolution(x))
        mean, log_deviation = jnp.split(self.convolutions[-1](x), 2, axis=-1)
        return jnp.concatenate([mean.reshape(-1), log_deviation.reshape(-1)])


class MapTransform(eqx.Module):
    """Five 3×3 convolutions with ReLU between them, from a map of latent numbers to the maps of q and p.

    Attributes:
        convolutions: in the order of application.
        coarse: rows and columns of the cells.
    """

    convolutions: tuple[Conv, ...]
    coarse: tuple[int, int] = eqx.field(static=True)

    def __init__(self, coarse: tuple[int, int], maps: int, channels: int = 64, *, key: PRNGKeyArray):
        """Build the layers.

        Args:
            coarse: rows and columns of the cells.
            maps: numbers of a cell, the same before and after; even.
            channels: of the convolutions between.
            key: of the random kernels.
        """
        widths, keys = [maps, *[channels] * 4, maps], jax.random.split(key, 5)
        self.convolutions = tuple(
            Conv(a, b, 3, 1, truncated_normal, key=k) for (a, b), k in zip(pairwise(widths), keys, strict=True)
        )
        self.coarse = coarse

    def __call__(self, latent: Float[Array, "D"]) -> Float[Array, "D"]:
        """Return all of q, then all of p."""
        x = latent.reshape(*self.coarse, -1)
        for convolution in self.convolutions[:-1]:
            x = jax.nn.relu(convolution(x))
        q, p = jnp.split(self.convolutions[-1](x), 2, axis=-1)
        return jnp.concatenate([q.reshape(-1), p.reshape(-1)])


class MapEnergy(eqx.Module):
    """An energy of a map of 4×4 cells: five convolutions down to one cell, softplus between them.

    Attributes:
        convolutions: in the order of application.
        coarse: rows and columns of the cells.
    """

    convolutions: tuple[Conv, ...]
    coarse: tuple[int, int] = eqx.field(static=True)

    def __init__(self, coarse: tuple[int, int], maps: int, channels: int = 64, *, key: PRNGKeyArray):
        """Build the layers.

        Args:
            coarse: rows and columns of the cells.
            maps: numbers of a cell.
            channels: of the convolutions; the first has half of them.
            key: of the random kernels.
        """
        widths, keys = [maps, channels // 2, channels, channels, channels, 1], jax.random.split(key, 5)
        kernels = [(3, 1), (2, 2), (2, 1), (2, 2), (2, 1)]
        self.convolutions = tuple(
            Conv(a, b, *kernel, truncated_normal, key=k)
            for (a, b), kernel, k in zip(pairwise(widths), kernels, keys, strict=True)
        )
        self.coarse = coarse

    def __call__(self, x: Float[Array, "n"]) -> Float[Array, ""]:
        """Return the energy of a flat map."""
        y = x.reshape(*self.coarse, -1)
        for convolution in self.convolutions[:-1]:
            y = jax.nn.softplus(convolution(y))
        return jnp.sum(self.convolutions[-1](y))
