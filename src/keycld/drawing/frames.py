"""Arrange frames in rows and columns. A stack is a uint8 array `[T, H, W, 3]`."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Shaped, UInt8

from keycld._errors import KeycldError

GAP_COLOUR = (24, 26, 30)


def as_uint8(frames: Shaped[np.ndarray, "*any"]) -> UInt8[np.ndarray, "*any"]:
    """Convert frames to uint8: floats in [0, 1] are scaled and rounded, NaN becomes black; uint8 is unchanged."""
    if frames.dtype == np.uint8:
        return frames
    clean = np.nan_to_num(frames, nan=0.0, posinf=1.0, neginf=0.0)
    return np.round(255.0 * np.clip(clean, 0.0, 1.0)).astype(np.uint8)


def enlarge(frames: UInt8[np.ndarray, "*T H W 3"], scale: int) -> UInt8[np.ndarray, "*T H2 W2 3"]:
    """Enlarge each pixel to a block of `scale` × `scale`."""
    return np.repeat(np.repeat(frames, scale, axis=-3), scale, axis=-2)


def side_by_side(
    stacks: Sequence[UInt8[np.ndarray, "_ _ _ 3"]],
    labels: Sequence[str] | None = None,
    gap: int = 4,
) -> UInt8[np.ndarray, "T H W 3"]:
    """Put stacks of equal height next to each other; a shorter one repeats its last frame.

    Args:
        stacks: one array `[T, H, W, 3]` for each panel, from left to right.
        labels: a text above each panel, or None.
        gap: dark pixels between panels.

    Raises:
        KeycldError: no stack, unequal heights, or another number of labels.
    """
    if not stacks or len({stack.shape[1] for stack in stacks}) != 1:
        heights = [stack.shape[1] for stack in stacks]
        raise KeycldError(f"panels side by side need equal heights; got {heights}: enlarge the smaller ones.")
    if labels is not None and len(labels) != len(stacks):
        raise KeycldError(f"{len(stacks)} panels need as many labels; got {len(labels)}.")
    length = max(len(stack) for stack in stacks)
    panels = []
    for k, stack in enumerate(stacks):
        held = np.concatenate([stack, np.repeat(stack[-1:], length - len(stack), axis=0)])
        if labels is not None:
            strip = text_strip(labels[k], held.shape[2])
            held = np.concatenate([np.broadcast_to(strip, (length, *strip.shape)), held], axis=1)
        if k > 0:
            panels.append(_blank((length, held.shape[1], gap, 3)))
        panels.append(held)
    return np.concatenate(panels, axis=2)


def sheet(rows: Sequence[UInt8[np.ndarray, "_ _ _ 3"]], every: int = 6, gap: int = 1) -> UInt8[np.ndarray, "H W 3"]:
    """Lay out every `every`-th frame from left to right, one stack a row (the KeyCLD paper's Fig. 4).

    Args:
        rows: stacks with equal shapes, for example ground truth above prediction.
        every: frames from one column to the next; the paper shows every sixth of 50.
        gap: dark pixels between frames.

    Raises:
        KeycldError: no row, or rows of unequal shapes.
    """
    if not rows or len({row.shape for row in rows}) != 1:
        raise KeycldError(f"the rows of a sheet need one shape; got {[row.shape for row in rows]}.")
    lines = []
    for k, row in enumerate(rows):
        line = side_by_side([frame[None] for frame in row[::every]], gap=gap)[0]
        if k > 0:
            lines.append(_blank((gap, line.shape[1], 3)))
        lines.append(line)
    return np.concatenate(lines, axis=0)


def labelled_sheet(
    rows: Sequence[UInt8[np.ndarray, "_ _ _ 3"]],
    labels: Sequence[str],
    heads: Sequence[str],
    scale: int = 2,
    gap: int = 2,
) -> UInt8[np.ndarray, "H W 3"]:
    """Lay out every frame from left to right, one stack a row, with labels (the KeyCLD paper's Figs. 13 to 15).

    Args:
        rows: stacks of one shape, one frame a column.
        labels: left of each row.
        heads: above each column.
        scale: enlargement of the frames.
        gap: dark pixels between frames.

    Raises:
        KeycldError: rows of unequal shapes, or not one label for each row and one head for each column.
    """
    large = [enlarge(row, scale) for row in rows]
    picture = sheet(large, every=1, gap=gap)
    count, height, width, _ = large[0].shape
    if (len(labels), len(heads)) != (len(rows), count):
        raise KeycldError(
            f"a sheet of {len(rows)} rows and {count} columns needs as many labels and heads; got {len(labels)} and "
            f"{len(heads)}."
        )
    # Pixels at the font size of `text_strip`; the longest label decides.
    side = max(40, 8 * max(len(label) for label in labels) + 16)
    column = [text_strip(label, side, height) for label in labels]
    row = [text_strip(head, width) for head in heads]
    left = _stacked(column, gap, axis=0)
    top = _stacked(row, gap, axis=1)
    corner = _blank((top.shape[0], side, 3))
    return np.concatenate([np.concatenate([corner, left]), np.concatenate([top, picture])], axis=1)


def _stacked(parts: Sequence[np.ndarray], gap: int, axis: int) -> np.ndarray:
    """Pictures in a line with dark pixels between them."""
    shape = list(parts[0].shape)
    shape[axis] = gap
    spaced = [piece for part in parts for piece in (_blank(tuple(shape)), part)]
    return np.concatenate(spaced[1:], axis=axis)


def text_strip(text: str, width: int, height: int = 22) -> UInt8[np.ndarray, "height width 3"]:
    """Make a dark strip with a centred text."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width / 100.0, height / 100.0), dpi=100.0)
    figure.patch.set_facecolor("#{:02x}{:02x}{:02x}".format(*GAP_COLOUR))
    figure.text(0.5, 0.5, text, ha="center", va="center", color="white", fontsize=min(9.0, 0.3 * height + 2.0))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:height, :width, :3].copy()


def _blank(shape: tuple[int, ...]) -> np.ndarray:
    return np.broadcast_to(np.array(GAP_COLOUR, np.uint8), shape)
