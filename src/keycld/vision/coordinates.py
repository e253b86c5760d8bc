"""Between pixels and the image plane.

Image-plane units: origin at the image centre, x to the right, y **up**, isotropic, ±1 at the centres of the
outermost pixels of the shorter side. One pixel of a 64×64 image is 2/63.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def pixel_size(height: int, width: int) -> float:
    """Return the side of a pixel of an image, in image-plane units."""
    return 2.0 / (min(height, width) - 1)


def image_grid(height: int, width: int, stride: int = 1) -> Float[Array, "rows columns 2"]:
    """Return the positions (x, y) of the cells of an image, in image-plane units.

    Args:
        height: rows of the image, pixels.
        width: columns of the image, pixels.
        stride: a cell is a square of `stride × stride` pixels and lies at its middle; with 1 the cells are the pixels.
    """
    unit = pixel_size(height, width)
    rows = jnp.arange(height // stride) * stride + (stride - 1) / 2
    columns = jnp.arange(width // stride) * stride + (stride - 1) / 2
    y = ((height - 1) / 2 - rows) * unit
    x = (columns - (width - 1) / 2) * unit
    return jnp.stack(jnp.broadcast_arrays(x[None, :], y[:, None]), axis=-1)


def spatial_softmax(
    logits: Float[Array, "rows columns K"], grid: Float[Array, "rows columns 2"]
) -> tuple[Float[Array, "K 2"], Float[Array, "rows columns K"]]:
    """Return keypoints as the expected position under a softmax over all cells, eq. (8) of the paper.

    xₖ = Σ_p p · exp(s_k(p)) / Σ_p' exp(s_k(p')), summed over the cells p.

    Args:
        logits: one map s_k for each keypoint.
        grid: positions of the cells, from `image_grid`.

    Returns:
        The keypoints in the units of `grid`, and the heat maps, each of which sums to one.
    """
    maps = jax.nn.softmax(logits.reshape(-1, logits.shape[-1]), axis=0)
    keypoints = jnp.einsum("pk,pd->kd", maps, grid.reshape(-1, 2), precision="highest")
    return keypoints, maps.reshape(logits.shape)


def gaussian_maps(
    keypoints: Float[Array, "K 2"], grid: Float[Array, "rows columns 2"], sigma: float | Float[Array, ""]
) -> Float[Array, "rows columns K"]:
    """Return one Gaussian map for each keypoint, exp(−‖p − x‖² / 2σ²) at each cell p, eq. (9) of the paper.

    Args:
        keypoints: positions x, image-plane units.
        grid: positions of the cells, from `image_grid`.
        sigma: σ, image-plane units. Good values: 0.1 (the paper), 0.05 for targets of heat maps.
    """
    # exp(-(a² + b²)) = exp(-a²) exp(-b²): two short vectors instead of a map of exponentials.
    x = jnp.exp(-((grid[0, :, 0][:, None] - keypoints[None, :, 0]) ** 2) / (2 * sigma**2))
    y = jnp.exp(-((grid[:, 0, 1][:, None] - keypoints[None, :, 1]) ** 2) / (2 * sigma**2))
    return y[:, None, :] * x[None, :, :]
