"""The work of one renderer process: simulate and draw a few runs and leave them as one part file."""

import json
from pathlib import Path

import numpy as np

from keycld._errors import KeycldError
from keycld.data.atomic import atomic
from keycld.data.protocols import Split
from keycld.systems import AbstractSystem, Run, draw_here

# Frames of a part: about ten seconds of drawing on a CPU, the most that a kill loses.
PART_FRAMES = 1500
_LARGEST_TURN = 1.0
_MOST_DRAWS = 1000


def leaves_image(system: AbstractSystem, run: Run) -> bool:
    """Whether a keypoint comes to lie outside the picture."""
    return bool(np.any(np.abs(system.landmarks(run.state)) > 1.0))


def turns_too_fast(system: AbstractSystem, run: Run) -> bool:
    """Whether an angle changes by more than 1 rad between two frames, so that its sense of rotation gets lost."""
    angles = [unit == "rad" for unit in system.units]
    return bool(np.any(np.abs(np.diff(run.state[:, angles], axis=0)) > _LARGEST_TURN))


def record(system: AbstractSystem, split: Split, seed: int) -> tuple[Run, int]:
    """The run of one seed, and how many were drawn before one passed the screen (1 where there is none)."""
    random = np.random.RandomState(seed)
    for draws in range(1, _MOST_DRAWS + 1):
        run = system.record(random, split.frames, split.conditions)
        if not split.screened or not (leaves_image(system, run) or turns_too_fast(system, run)):
            return run, draws
    raise KeycldError(f"no run of seed {seed} stayed in the image in {_MOST_DRAWS} draws: use fewer frames.")


def make_part(system: AbstractSystem, split: Split, seeds: tuple[int, ...], path: Path) -> int:
    """Write the runs of `seeds` to `path` (an .npz); returns the number of frames drawn."""
    recorded = [record(system, split, seed) for seed in seeds]
    runs = [run for run, _ in recorded]
    state = np.stack([run.state for run in runs])
    image, description = draw_here(system, state.reshape(-1, state.shape[-1]))
    with atomic(path) as temporary, open(temporary, "wb") as file:
        np.savez(
            file,
            time=runs[0].time,
            input=np.stack([run.input for run in runs]),
            state=state,
            state_derivative=np.stack([run.state_derivative for run in runs]),
            image=image.reshape(*state.shape[:2], *image.shape[1:]),
            seed=np.array(seeds),
            draws=np.array([draws for _, draws in recorded]),
            renderer=json.dumps(description),
        )
    return len(image)


def make_sweep_part(system: AbstractSystem, path: Path) -> int:
    """Write the pictures of all sweep paths, one after another, to `path`; returns their number."""
    state = np.concatenate([sweep.state for sweep in system.sweeps()])
    image, description = draw_here(system, state)
    with atomic(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, image=image, renderer=json.dumps(description))
    return len(image)
