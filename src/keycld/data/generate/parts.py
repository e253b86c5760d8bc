"""The work of one renderer process: simulate and render a few runs and write them as one file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from keycld._errors import KeycldError
from keycld.data.format.trajectories import Trajectories
from keycld.data.format.writing import write
from keycld.data.generate.protocols import Split
from keycld.systems import AbstractMechanism, Run, Task, render_in_worker

_LARGEST_TURN = 1.0
_MOST_DRAWS = 1000


class Part(NamedTuple):
    """A piece of a data set: `task` writes `frames` frames of the file `split` to `path`."""

    split: str
    frames: int
    path: Path
    task: Task


def _leaves_image(system: AbstractMechanism, run: Run) -> bool:
    return bool(np.any(np.abs(system.landmarks(run.state)) > 1.0))


def _turns_too_fast(system: AbstractMechanism, run: Run) -> bool:
    """Tell whether an angle changes by more than 1 rad between two frames: beyond π its direction is ambiguous."""
    angles = [unit == "rad" for unit in system.units]
    return bool(np.any(np.abs(np.diff(run.state[:, angles], axis=0)) > _LARGEST_TURN))


def record(system: AbstractMechanism, split: Split, seed: int) -> tuple[Run, int]:
    """Simulate the run of one seed, and count the runs sampled until one passed the screen (1 without a screen).

    Raises:
        KeycldError: none of a thousand passed.
    """
    random = np.random.RandomState(seed)
    for draws in range(1, _MOST_DRAWS + 1):
        run = system.record(random, split.frames, split.conditions)
        if not split.screened or not (_leaves_image(system, run) or _turns_too_fast(system, run)):
            return run, draws
    raise KeycldError(f"no recording of seed {seed} stayed in the image in {_MOST_DRAWS} draws: use fewer frames.")


def make_part(
    system: AbstractMechanism, split: Split, seeds: tuple[int, ...], attributes: Mapping[str, Any], path: Path
) -> None:
    """Write the runs of `seeds` to `path`, with the inputs that `attributes["input_names"]` lists."""
    acting = [system.input_names.index(name) for name in attributes["input_names"]]
    recorded = [record(system, split, seed) for seed in seeds]
    runs = [run for run, _ in recorded]
    state = np.stack([run.state for run in runs])
    image, renderer = render_in_worker(system, state.reshape(-1, state.shape[-1]))
    trajectories = Trajectories(
        time=runs[0].time,
        input=np.stack([run.input[..., acting] for run in runs]).astype(np.float32),
        image=image.reshape(*state.shape[:2], *image.shape[1:]),
        state=state,
        state_derivative=np.stack([run.state_derivative for run in runs]),
        parameters={"seed": np.array(seeds), "draws": np.array([draws for _, draws in recorded])},
        attributes={**attributes, **split.conditions.described(), "seed": split.seeds[0], "renderer": renderer},
    )
    write(path, trajectories)
