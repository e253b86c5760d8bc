"""Paths and grids over a configuration space."""

from collections.abc import Mapping, Sequence

import numpy as np

from keycld.systems.base import SweepPath

PATH_POINTS = 64
GRID_POINTS = 16
FULL_TURN = (-np.pi, np.pi)


def path(
    state_names: Sequence[str], name: str, vary: Mapping[str, tuple[float, float]], fixed: Mapping[str, float]
) -> SweepPath:
    """Return 64 states at rest along one coordinate; all that is not named is zero.

    Args:
        state_names: names of all components of the state.
        name: of the path.
        vary: the name of one coordinate with its first and its last value, both included.
        fixed: values of other coordinates.
    """
    (varied, (low, high)), *_ = vary.items()
    state = np.zeros((PATH_POINTS, len(state_names)))
    for other, value in fixed.items():
        state[:, state_names.index(other)] = value
    state[:, state_names.index(varied)] = np.linspace(low, high, PATH_POINTS)
    return SweepPath(name, state, (PATH_POINTS,), (varied,))


def grid(state_names: Sequence[str], name: str, vary: Mapping[str, tuple[float, float]]) -> SweepPath:
    """Return all combinations of 16 values of each coordinate in `vary`, the last coordinate changing fastest."""
    axes = [np.linspace(low, high, GRID_POINTS) for low, high in vary.values()]
    points = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=-1)
    state = np.zeros((len(points), len(state_names)))
    for column, varied in enumerate(vary):
        state[:, state_names.index(varied)] = points[:, column]
    return SweepPath(name, state, (GRID_POINTS,) * len(axes), tuple(vary))
