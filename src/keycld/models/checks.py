"""Refusals that every model shares."""

from jaxtyping import Array, Float

from keycld._errors import KeycldError


def check_size(frame: Float[Array, "*any"], size: tuple[int, int]) -> None:
    """Refuse a frame that is not `[*size, 3]`.

    Raises:
        KeycldError: names both sizes.
    """
    if frame.shape != (*size, 3):
        height, width = size
        raise KeycldError(
            f"this model sees frames of {height} × {width} pixels with three colours, not of shape "
            f"{list(frame.shape)}: give pictures of that size."
        )


def check_inputs(u: Float[Array, "*steps l"], inputs: int) -> None:
    """Refuse another number of inputs than a model has.

    Raises:
        KeycldError: names both numbers.
    """
    if u.shape[-1] != inputs:
        raise KeycldError(
            f"this model has {inputs} inputs, not {u.shape[-1]}: give data of the system that it was trained on."
        )
