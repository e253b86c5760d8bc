"""Soft coloured discs on grey: the pictures of the toy physics and molecular dynamics sets."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

NAME = "soft discs"
VERSION = 1

# Slope of a disc's edge, per width of the canvas: about two pixels from full to none at 32 × 32.
_SHARPNESS = 80.0
# The suite's authors found training harder on black.
BACKGROUND = (0.321, 0.349, 0.368)
# In float64 a value that lies less than this below 1 is rounded to 1.
_ROUNDED_UP = 2.0**-54


def soft_discs(
    centres: Float[Array, "n 2"],
    radii: Float[Array, "n"],
    colours: Float[Array, "n 3"],
    canvas: Float[Array, "2"],
    size: int = 32,
) -> Float[Array, "{size} {size} 3"]:
    """Render one picture, values in [0, 1].

    With lengths in units of the canvas' width, disc k covers a pixel at distance d from its centre by
    M_k = 1 / (1 + exp(80 (d − ρ_k))); the picture is Σ_k M_k Π_{j<k} (1 − M_j) C_k + Π_j (1 − M_j) · grey, so
    disc 0 lies on top. Pixel j is at j / (size − 1). Columns are x, rows are y, and y grows **downward**.

    What is computed is 1 − picture = Σ_k M_k Π_{j<k} (1 − M_j) (1 − C_k) + Π_j (1 − M_j) (1 − grey), from
    1 − M_k = M_k exp(80 (d − ρ_k)). Inside a disc of full colour, and where such discs overlap, this is small and keeps
    its relative precision in float32, whereas the picture itself would be rounded to 1: byte 255 instead of 254.

    Args:
        centres: (x, y) of each disc, world units.
        radii: world units.
        colours: RGB in [0, 1].
        canvas: (low, high), world units, the same for x and y.
        size: pixels of a side.

    Source: the renderer of `dm_hamiltonian_dynamics_suite` ("Which priors matter?", section 4.1). Equal to it
    in uint8 when computed in float64; in float32 about two bytes in 100,000 differ, by one level.
    """
    width = canvas[1] - canvas[0]
    places, sizes = (centres - canvas[0]) / width, radii / width
    pixels = jnp.arange(size) / (size - 1.0)
    across = pixels[None, None, :] - places[:, 0, None, None]
    down = pixels[None, :, None] - places[:, 1, None, None]
    odds = jnp.exp(_SHARPNESS * (jnp.sqrt(across**2 + down**2) - sizes[:, None, None]))
    masks = 1.0 / (1.0 + odds)
    through = jnp.where(masks > 0.5, jnp.minimum(odds, 1.0) * masks, 1.0 - masks)
    missing = jnp.broadcast_to(1.0 - jnp.asarray(BACKGROUND, masks.dtype)[None, None, :], (size, size, 3))
    for mask, clear, colour in zip(
        masks[::-1], through[::-1], colours[::-1], strict=True
    ):  # from the back to the front
        missing = mask[:, :, None] * (1.0 - colour)[None, None, :] + clear[:, :, None] * missing
    below_one = 1.0 - jnp.finfo(missing.dtype).epsneg
    return jnp.where(missing > _ROUNDED_UP, jnp.minimum(1.0 - missing, below_one), 1.0 - missing)


def hue_colours(hues: int) -> Float[np.ndarray, "hues 3"]:
    """Return the RGB colours of hue k / `hues`; six give red, yellow, green, cyan, blue, magenta."""
    sector = 6.0 * np.arange(hues) / hues
    # Each channel is a trapezium over the hue, and the three are a third of a turn apart.
    distance = [np.abs((sector - centre + 3.0) % 6.0 - 3.0) for centre in (0.0, 2.0, 4.0)]
    return np.clip(2.0 - np.stack(distance, axis=-1), 0.0, 1.0)
