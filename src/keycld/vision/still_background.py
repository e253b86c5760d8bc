"""What a camera at rest sees behind the parts that move."""

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

# Frames that are compared.
_FRAMES = 100
# Colours of a place, 0 to 1, that are nearer than this are one, and than so many times the noise.
_ALIKE, _NOISES = 0.04, 4.0
# Colours that are told apart at a place, and share of the frames that shows one.
_COLOURS, _LEAST = 3, 0.04
# Cost of a difference of 1 between neighbours, next to that of a colour that is seen in 1/e of the frames.
_EDGE = 5.0
_SWEEPS = 40
# Share of a part that its middle has at least, and width of its border in pixels.
_MIDDLE, _BORDER = 0.35, 3
# Places farther than a pixel from that middle which the part passes, as a share of it, at least.
_PASSED = 0.1
# Places whose frames are compared at a time.
_CHUNK = 256


def still_background(frames: UInt8[np.ndarray, "N H W 3"]) -> Float[np.ndarray, "H W 3"]:
    """Return the background, 0 to 1, also where parts are in front of it for most of the time.

    The median frame shows a part wherever this is for more than half of the time: a cart that is longer than its swing
    stands in the middle of it. There the part is then invisible, and its keypoint slides: by 1.2 pixels of 64 on a
    drawn cart, by 0.1 with this background.

    Each place p has up to three colours a, those that most frames agree on, with shares s(p, a) of the frames. The
    background takes the one from each that makes

        Σ_p −log s(p, a_p) + λ Σ_(p,q) |a_p − a_q|,    (p, q) neighbours, λ = 5,

    small: the picture with the shortest and faintest edges, so that a part which seldom moves is left out of it, and
    the end of a rod at its pivot does not grow. It begins with the colours that are nearest to a harmonic continuation
    of all places that hardly ever change, and is improved place by place (iterated conditional modes; Besag, J. R.
    Stat. Soc. B 48, 259, 1986).

    The middle of a part that moves by less than its length is never seen without it. Places that always have the colour
    of what passes beside them are taken for such a middle if they are more than a third of all that has this colour in
    a frame, and do not reach the border of the picture: their colours are continued from around them. The part must
    also pass places farther than a pixel away: edges of a box in the background tremble with the hand that holds the
    camera.

    Args:
        frames: of a camera at rest, at any times.
    """
    some = frames[np.linspace(0, len(frames) - 1, min(_FRAMES, len(frames))).astype(int)].astype(np.float32) / 255
    median = np.median(some, axis=0)
    far = _distance(some, median)
    alike = max(_ALIKE, _NOISES * float(np.median(far)))
    still = np.mean(far > alike, axis=0) < _LEAST
    if still.all() or not still.any():
        return median
    colours = np.repeat(median[None], _COLOURS, axis=0)
    costs = np.full((_COLOURS, *still.shape), np.inf, np.float32)
    costs[0] = 0.0
    colours[:, ~still], shares = _colours(np.moveaxis(some[:, ~still], 0, 1), alike)
    costs[:, ~still] = np.where(shares >= _LEAST, -np.log(np.maximum(shares, _LEAST)), np.inf)
    costs[0, ~still] = -np.log(shares[0])
    choice = _smoothest(colours, costs, _continued(median, still))
    found = _picture(colours, choice)
    passing = np.isfinite(costs) & (np.arange(_COLOURS)[:, None, None] != choice) & ~still
    hidden = _hidden(some, found, still, np.where(passing[..., None], colours, np.inf), 2 * alike)
    return _continued(found, ~hidden) if hidden.any() else found


def _picture(colours: Float[np.ndarray, "k H W 3"], choice: np.ndarray) -> Float[np.ndarray, "H W 3"]:
    return np.take_along_axis(colours, choice[None, ..., None], axis=0)[0]


def _hidden(
    frames: Float[np.ndarray, "N H W 3"],
    found: Float[np.ndarray, "H W 3"],
    still: Bool[np.ndarray, "H W"],
    passing: Float[np.ndarray, "k H W 3"],
    alike: float,
) -> Bool[np.ndarray, "H W"]:
    """Return the places that are always behind the middle of a part, and the border of the part around them.

    Args:
        frames: the frames that are compared.
        found: the background so far.
        still: where it hardly ever changes.
        passing: colours of parts that pass a place; infinite where there are fewer.
        alike: colours that are nearer than this are one.
    """
    from scipy import ndimage

    # Places whose background is a colour that passes a neighbour.
    beside = np.zeros_like(still)
    for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
        beside |= np.any(_distance(np.roll(passing, step, axis=axis + 1), found) < alike, axis=0)
    hidden = np.zeros_like(still)
    while beside.any():
        colour = found[tuple(np.argwhere(beside)[0])]
        same = _distance(found, colour) < alike
        places = np.zeros(same.shape, int)
        ndimage.label(same, output=places)
        for k in np.unique(places[beside & same]):
            middle = places == k
            if middle[[0, -1]].any() or middle[:, [0, -1]].any():
                continue
            own = np.mean(found[middle], axis=0)
            around = np.asarray(ndimage.binary_dilation(middle), bool)
            passed = np.any(_distance(passing, own) < alike, axis=0) & ~around
            if np.sum(passed) < _PASSED * np.sum(middle):
                continue
            seen = _distance(frames[:, ~(still | middle)], own) < alike
            if np.sum(middle) > _MIDDLE * (np.sum(seen) / len(frames) + np.sum(middle)):
                hidden |= np.asarray(ndimage.binary_dilation(middle, iterations=_BORDER), bool)
        beside &= ~same
    return hidden


def _distance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return root mean squares of differences of colours `[..., 3]`."""
    return np.sqrt(np.mean((one - other) ** 2, axis=-1))


def _colours(
    seen: Float[np.ndarray, "P N 3"], alike: float
) -> tuple[Float[np.ndarray, "k P 3"], Float[np.ndarray, "k P"]]:
    """Return the colours that most frames agree on at each of P places, the commonest first, and their shares."""
    colours = np.zeros((_COLOURS, len(seen), 3), np.float32)
    shares = np.zeros((_COLOURS, len(seen)), np.float32)
    for begin in range(0, len(seen), _CHUNK):
        chunk = seen[begin : begin + _CHUNK]
        squares = np.sum(chunk**2, axis=-1)
        # |a − b|² of all pairs of frames.
        apart = squares[:, :, None] + squares[:, None] - 2 * chunk @ chunk.swapaxes(1, 2)
        near = apart < 3 * alike**2
        left = np.ones(chunk.shape[:2], bool)
        for k in range(_COLOURS):
            best = np.argmax(np.sum(near & left[:, None], axis=-1) * left, axis=1)
            members = near[np.arange(len(chunk)), best] & left
            count = np.sum(members, axis=1)
            total = np.einsum("pn,pnc->pc", members.astype(np.float32), chunk)
            colours[k, begin : begin + _CHUNK] = total / np.maximum(count, 1)[:, None]
            shares[k, begin : begin + _CHUNK] = count / chunk.shape[1]
            left &= ~members
    return colours, shares


def _continued(picture: Float[np.ndarray, "H W 3"], known: Bool[np.ndarray, "H W"]) -> Float[np.ndarray, "H W 3"]:
    """Return the picture with the mean of their neighbours at all places that are not known."""
    from scipy import sparse
    from scipy.sparse.linalg import spsolve

    number = np.arange(known.size).reshape(known.shape)
    pairs = np.concatenate(
        [
            np.stack([number[:, 1:].ravel(), number[:, :-1].ravel()]),
            np.stack([number[1:].ravel(), number[:-1].ravel()]),
        ],
        axis=1,
    )
    graph = sparse.coo_matrix((np.ones(pairs.shape[1]), pairs), shape=(known.size, known.size))
    graph = (graph + graph.T).tocsr()
    laplacian = (sparse.diags(np.asarray(graph.sum(axis=1)).ravel()) - graph).tocsr()
    open_ = ~known.ravel()
    found = picture.reshape(-1, 3).astype(float)
    rows = laplacian[open_]
    found[open_] = spsolve(rows[:, open_].tocsc(), -(rows[:, ~open_] @ found[~open_]))
    return found.reshape(picture.shape).astype(np.float32)


def _smoothest(
    colours: Float[np.ndarray, "k H W 3"], costs: Float[np.ndarray, "k H W"], first: Float[np.ndarray, "H W 3"]
) -> Int[np.ndarray, "H W"]:
    """Return which colour each place has in the picture whose cost no change of a single place makes less."""
    choice = np.argmin(np.where(np.isfinite(costs), _distance(colours, first), np.inf), axis=0)
    height, width = choice.shape
    white = np.indices(choice.shape).sum(axis=0) % 2 == 0
    for _ in range(_SWEEPS):
        before = choice
        # The neighbours of a white place are black.
        for field in (white, ~white):
            padded = np.pad(_picture(colours, choice), ((1, 1), (1, 1), (0, 0)), mode="edge")
            total = costs.copy()
            for row, column in ((0, 1), (2, 1), (1, 0), (1, 2)):
                total += _EDGE * _distance(colours, padded[row : row + height, column : column + width])
            choice = np.where(field, np.argmin(total, axis=0), choice)
        if np.array_equal(choice, before):
            break
    return choice
