"""The true configuration in a state: positions come first, and some of them are angles."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int


def angular(attributes: Mapping[str, Any]) -> Bool[np.ndarray, "m"]:
    """Return which positions are angles: those of the first half of a state's components whose unit is rad."""
    units = tuple(attributes["units"])
    return np.array([unit == "rad" for unit in units[: len(units) // 2]])


def positions(state: Float[np.ndarray, "*any d"]) -> Float[np.ndarray, "*any m"]:
    """Return the positions q of states (q, q̇): the first half."""
    return state[..., : state.shape[-1] // 2]


def embed(q: Float[np.ndarray, "*any m"], angles: Bool[np.ndarray, "m"]) -> Float[np.ndarray, "*any f"]:
    """Return positions with every angle as its sine and cosine, so that near configurations are near numbers."""
    turning = q[..., angles]
    return np.concatenate([q[..., ~angles], np.sin(turning), np.cos(turning)], axis=-1)


def difference(
    q: Float[np.ndarray, "*any m"], other: Float[np.ndarray, "*any m"], angles: Bool[np.ndarray, "m"]
) -> Float[np.ndarray, "*any m"]:
    """Return the difference q − other, angles brought into ±π."""
    gap = q - other
    return np.where(angles, (gap + np.pi) % (2.0 * np.pi) - np.pi, gap)


def nearest(queries: Float[np.ndarray, "n f"], points: Float[np.ndarray, "m f"]) -> Int[np.ndarray, "n"]:
    """Return the index of the point nearest to each query."""
    from scipy.spatial import KDTree  # not at every start: it takes most of a second

    return np.asarray(KDTree(points).query(queries)[1])
