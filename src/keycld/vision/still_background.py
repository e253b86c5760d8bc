"""What a camera at rest sees behind the parts that move."""

import numpy as np
from jaxtyping import Bool, Float, UInt8

# Frames that are compared.
_FRAMES = 100
# Colours of a place, 0 to 1, that are nearer than this are one, and than so many times the noise.
_ALIKE, _NOISES = 0.04, 4.0
# Colours that are told apart at a place, and share of the frames that shows one.
_COLOURS, _LEAST = 3, 0.04
# Cost of a difference of 1 between neighbours, next to that of a colour that is seen in 1/e of the frames.
_EDGE = 10.0
_SWEEPS = 40
# Places whose frames are compared at a time.
_CHUNK = 256


def still_background(frames: UInt8[np.ndarray, "N H W 3"]) -> Float[np.ndarray, "H W 3"]:
    """Return the background, 0 to 1, also where parts are in front of it for most of the time.

    The median frame shows a part wherever this is for more than half of the time: a cart that is longer than its swing
    stands in the middle of it. There the part is then invisible, and its keypoint slides: by 1.2 pixels of 64 on a
    drawn cart, by 0.1 with this background.

    Each place p has up to three colours a, those that most frames agree on, with shares s(p, a) of the frames. The
    background takes the one from each that makes

        Σ_p −log s(p, a_p) + λ Σ_(p,q) |a_p − a_q|,    (p, q) neighbours, λ = 10,

    small: the picture with the shortest and faintest edges, so that a part which seldom moves is left out of it, and
    the end of a rod at its pivot does not grow. It begins with the colours that are nearest to a harmonic continuation
    of all places that hardly ever change, and is improved place by place (iterated conditional modes; Besag, J. R.
    Stat. Soc. B 48, 259, 1986). A place that is never seen without the part keeps the colour of the part.

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
    return _smoothest(colours, costs, _continued(median, still))


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
        near = _distance(chunk[:, :, None], chunk[:, None]) < alike
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
) -> Float[np.ndarray, "H W 3"]:
    """Return the picture of one colour from each place whose cost no other colour of a single place makes less."""
    choice = np.argmin(np.where(np.isfinite(costs), _distance(colours, first), np.inf), axis=0)
    height, width = choice.shape
    white = np.indices(choice.shape).sum(axis=0) % 2 == 0

    def picture() -> np.ndarray:
        return np.take_along_axis(colours, choice[None, ..., None], axis=0)[0]

    for _ in range(_SWEEPS):
        before = choice
        # The neighbours of a white place are black.
        for field in (white, ~white):
            padded = np.pad(picture(), ((1, 1), (1, 1), (0, 0)), mode="edge")
            total = costs.copy()
            for row, column in ((0, 1), (2, 1), (1, 0), (1, 2)):
                total += _EDGE * _distance(colours, padded[row : row + height, column : column + width])
            choice = np.where(field, np.argmin(total, axis=0), choice)
        if np.array_equal(choice, before):
            break
    return picture()
