"""Pictures along the paths of the energy figures: one file, one trajectory a path."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from keycld._errors import KeycldError
from keycld._files import checked_name
from keycld.data.format.trajectories import Trajectories
from keycld.data.format.writing import write
from keycld.systems import AbstractMechanism, render_in_worker


class Sweep(NamedTuple):
    """Pictures along a path, or over a grid, of the configuration space; everything is at rest.

    Attributes:
        name: of the path.
        vary: names of the states that change, one an axis of `shape`.
        shape: (n,) for a path, (rows, columns) for a grid, stored row by row.
        image: uint8 [n, H, W, 3].
        state: float64 [n, d].
    """

    name: str
    vary: tuple[str, ...]
    shape: tuple[int, ...]
    image: np.ndarray
    state: np.ndarray


def make_sweeps(system: AbstractMechanism, attributes: Mapping[str, Any], path: Path) -> None:
    """Render the sweeps of a system and write them to `path`; for a worker process."""
    sweeps = system.sweeps()
    lengths = np.array([len(sweep.state) for sweep in sweeps])
    image, renderer = render_in_worker(system, np.concatenate([sweep.state for sweep in sweeps]))
    # Shorter paths repeat their last point, so that one array holds all of them.
    within = np.minimum(np.arange(lengths.max())[None, :], lengths[:, None] - 1)
    index = np.cumsum([0, *lengths[:-1]])[:, None] + within
    trajectories = Trajectories(
        time=system.dt * np.arange(1, lengths.max() + 1),
        input=np.zeros((len(sweeps), len(attributes["input_names"])), np.float32),
        image=image[index],
        state=np.concatenate([sweep.state for sweep in sweeps])[index],
        parameters={
            "name": np.array([sweep.name for sweep in sweeps]),
            "vary": np.array([",".join(sweep.vary) for sweep in sweeps]),
            "length": lengths,
            "shape": np.array([(*sweep.shape, 1)[:2] for sweep in sweeps]),
        },
        attributes={**attributes, "seed": 0, "renderer": renderer},
    )
    write(path, trajectories)


def sweeps_of(trajectories: Trajectories) -> tuple[Sweep, ...]:
    """List the paths in a `sweeps.h5`, without the repeated points.

    Raises:
        KeycldError: the file does not describe them, or a name is none.
    """
    found, sweeps = trajectories.parameters, []
    names = trajectories.attributes.get("state_names", ())
    if trajectories.image is None or trajectories.state is None or not {"name", "vary", "length", "shape"} <= {*found}:
        raise KeycldError("sweeps.h5 lacks pictures, states or the parameters that describe its paths: make it again.")
    numbers = (found["length"], found["shape"])
    if any(each.dtype.kind not in "iu" or each.min() < 1 for each in numbers) or found["shape"].ndim != 2:
        raise KeycldError("the parameters 'length' and 'shape' in sweeps.h5 are no positive numbers: make it again.")
    for i in range(len(trajectories)):
        vary = tuple(str(found["vary"][i]).split(","))
        length = int(found["length"][i])
        shape = tuple(int(n) for n in found["shape"][i][: len(vary)])
        if not {*vary} <= {*names} or length > trajectories.frames or math.prod(shape) != length or len(vary) > 2:
            raise KeycldError(f"path {i} in sweeps.h5 has states, a length or a shape that do not fit: make it again.")
        sweeps.append(
            Sweep(
                name=checked_name(str(found["name"][i]), "sweeps.h5"),
                vary=vary,
                shape=shape,
                image=trajectories.image[i, :length],
                state=trajectories.state[i, :length],
            )
        )
    return tuple(sweeps)
