"""Soft coloured discs on grey: the pictures of the toy physics and molecular dynamics sets."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

NAME = "soft discs"
VERSION = 1

# Slope of a disc's edge, per width of the canvas: about two pixels from full to none at 32 × 32.
_SHARPNESS = 80.0
# The suite's authors found training harder on black.
BACKGROUND = (0.321, 0.349, 0.368)


def soft_discs(
    centres: Float[Array, "n 2"],
    radii: Float[Array, "n"],
    colours: Float[Array, "n 3"],
    canvas: Float[Array, "2"],
    size: int = 32,
) -> Float[Array, "{size} {size} 3"]:
    """One picture, values in [0, 1].

    With lengths in units of the canvas' width, disc k covers a pixel at distance d from its centre by
    M_k = 1 / (1 + exp(80 (d − ρ_k))); the picture is Σ_k M_k Π_{j<k} (1 − M_j) C_k + Π_j (1 − M_j) · grey, so
    disc 0 lies on top. Pixel j is at j / (size − 1). Columns are x, rows are y, and y grows **downward**.

    Args:
        centres: (x, y) of each disc, world units.
        radii: world units.
        colours: RGB in [0, 1].
        canvas: (low, high), world units, the same for x and y.
        size: pixels of a side.

    Source: the renderer of `dm_hamiltonian_dynamics_suite` ("Which priors matter?", section 4.1). Equal to it
    in uint8 when computed in float64; in float32 about one byte in 2,000 differs, by one level.
    """
    width = canvas[1] - canvas[0]
    places, sizes = (centres - canvas[0]) / width, radii / width
    pixels = jnp.arange(size) / (size - 1.0)
    across = pixels[None, None, :] - places[:, 0, None, None]
    down = pixels[None, :, None] - places[:, 1, None, None]
    masks = 1.0 / (1.0 + jnp.exp(_SHARPNESS * (jnp.sqrt(across**2 + down**2) - sizes[:, None, None])))
    picture = jnp.broadcast_to(jnp.asarray(BACKGROUND, masks.dtype)[None, None, :], (size, size, 3))
    for mask, colour in zip(masks[::-1], colours[::-1], strict=True):  # from the back to the front
        picture = mask[:, :, None] * colour[None, None, :] + (1.0 - mask)[:, :, None] * picture
    return picture


def hue_colours(hues: int) -> Float[np.ndarray, "hues 3"]:
    """The RGB colours of hue k / `hues`; six give red, yellow, green, cyan, blue, magenta."""
    sector = 6.0 * np.arange(hues) / hues
    # Each channel is a trapezium over the hue, and the three are a third of a turn apart.
    distance = [np.abs((sector - centre + 3.0) % 6.0 - 3.0) for centre in (0.0, 2.0, 4.0)]
    return np.clip(2.0 - np.stack(distance, axis=-1), 0.0, 1.0)


def to_bytes(picture: Float[Array, "*any"]) -> UInt8[Array, "*any"]:
    """Grey levels, cut off and not rounded, as the suite stores them."""
    return (255.0 * picture).astype(jnp.uint8)
