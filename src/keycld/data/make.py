"""Makes a data set: every split of a protocol and the sweeps, in parallel, to be resumed after any interruption."""

import contextlib
import json
import os
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from keycld import __version__
from keycld._errors import KeycldError
from keycld.data.atomic import atomic, writing_error
from keycld.data.card import write_card
from keycld.data.parts import PART_FRAMES, make_part, make_sweep_part
from keycld.data.protocols import Split, splits
from keycld.data.statistics import statistics, write_statistics
from keycld.data.store import Trajectories, write
from keycld.systems import AbstractSystem, get, run_in_processes

PARTIAL = ".partial"


@dataclass(frozen=True)
class Progress:
    """How far a long job is: `done` of `total` frames after `seconds`, and what is being done."""

    done: int
    total: int
    seconds: float
    what: str


@dataclass(frozen=True)
class Made:
    """The outcome of `make_data`.

    **Fields:** `folder`; `fresh`: False where the finished data was there already; `seconds`; `frames` drawn now
    (fewer than the set's after a resumed interruption); `renderer`: what drew them.
    """

    folder: Path
    fresh: bool
    seconds: float
    frames: int
    renderer: str


def make_data(
    system: str | AbstractSystem,
    out: str | os.PathLike | None = None,
    *,
    protocol: str = "keycld-2022",
    control: Literal["none", "under", "full"] | None = None,
    start: Literal["rest", "random"] | None = None,
    clip: bool | None = None,
    runs: Mapping[str, int] | None = None,
    frames: Mapping[str, int] | None = None,
    workers: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Made:
    """Make the data set of a system.

    The same arguments give the same simulated numbers, whatever `workers` is and however often it was interrupted;
    pictures depend on the GL driver too. Interrupted work lies in `OUT/.partial` and is taken up by the same call.

    **Arguments:**

    - `system`: a name of `keycld.systems.names()`, or a system.
    - `out`: the folder (default `data/NAME`).
    - `protocol`: `"keycld-2022"` (arXiv v1) or `"keycld-2024"` (journal version).
    - `control`, `start`, `clip`: replace the protocol's conditions in train, validation and test.
    - `runs`, `frames`: numbers by split (`{"train": 2, ...}`), for small sets.
    - `workers`: renderer processes, at most four (default: one a core).
    - `progress`: called after each part.

    **Raises:** `KeycldError` for unknown names, a folder that cannot be written or holds other data, a full disk, no GL.

    **Good values:** the defaults; 52,900 frames take about two and a half minutes on two cores without a GPU.
    """
    system = get(system) if isinstance(system, str) else system
    folder = Path(out) if out is not None else Path("data") / system.name
    plan = splits(protocol, control=control, start=start, clip=clip, runs=runs, frames=frames)
    for split in plan:
        system.check(split.conditions)
    recipe = json.loads(
        json.dumps({"system": system.name, "protocol": protocol, "splits": [asdict(split) for split in plan]})
    )
    finished = _finished_recipe(folder)
    if finished is not None:
        _same(recipe, finished, folder)
        return Made(folder, False, 0.0, 0, "")
    began = time.monotonic()
    _begin(folder, recipe)
    drawn = _make_parts(system, plan, folder / PARTIAL, workers, progress, began)
    renderer = _assemble(system, plan, protocol, folder)
    seconds = time.monotonic() - began
    figures = statistics(folder, [split.name for split in plan])
    write_statistics(folder, {**figures, "recipe": recipe, "renderer": renderer, "seconds": round(seconds, 1)})
    write_card(folder, system)
    shutil.rmtree(folder / PARTIAL)
    return Made(folder, True, seconds, drawn, renderer)


def _read_recipe(path: Path) -> dict[str, Any] | None:
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise KeycldError(f"{path} is damaged ({error}): delete {path.parent} and make the data again.") from error


def _finished_recipe(folder: Path) -> dict[str, Any] | None:
    if (folder / PARTIAL).exists():
        return None
    stored = _read_recipe(folder / "statistics.json")
    return None if stored is None else stored.get("recipe", {})


def _same(wanted: Any, found: Any, folder: Path) -> None:
    if wanted == found:
        return
    changed = [key for key in wanted if not isinstance(found, dict) or wanted[key] != found.get(key)]
    raise KeycldError(
        f"{folder} holds data made with another {' and '.join(changed)}: choose another folder, or delete it first."
    )


def _begin(folder: Path, recipe: dict[str, Any]) -> None:
    partial = folder / PARTIAL
    started = _read_recipe(partial / "recipe.json")
    if started is not None:
        _same(recipe, started, folder)
        return
    taken = [path.name for path in folder.glob("*.h5")]
    if taken:
        raise KeycldError(f"{folder} already holds {taken[0]}, which keycld did not finish: choose an empty folder.")
    try:
        partial.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise writing_error(partial, error) from error
    with atomic(partial / "recipe.json") as temporary:
        temporary.write_text(json.dumps(recipe))


def _parts(split: Split) -> list[tuple[str, tuple[int, ...]]]:
    size = max(1, PART_FRAMES // split.frames)
    seeds = range(*split.seeds)
    return [
        (f"{split.name}-{first:05d}.npz", tuple(seeds[first : first + size])) for first in range(0, len(seeds), size)
    ]


def _make_parts(
    system: AbstractSystem,
    plan: tuple[Split, ...],
    partial: Path,
    workers: int | None,
    progress: Callable[[Progress], None] | None,
    began: float,
) -> int:
    tasks, sizes = [], []
    for split in plan:
        for name, seeds in _parts(split):
            tasks.append((_part, (system, split, seeds, partial / name)))
            sizes.append(len(seeds) * split.frames)
    tasks.append((_sweep_part, (system, partial / "sweeps.npz")))
    sizes.append(sum(len(sweep.state) for sweep in system.sweeps()))
    open_tasks = [index for index, (_, arguments) in enumerate(tasks) if not arguments[-1].exists()]
    total, done = sum(sizes), sum(sizes) - sum(sizes[index] for index in open_tasks)
    drawn = 0
    for position, frames in run_in_processes(
        _call, [tasks[index] for index in open_tasks], workers=workers
    ):
        done, drawn = done + frames, drawn + frames
        if progress is not None:
            what = tasks[open_tasks[position]][1][-1].stem
            progress(Progress(done, total, time.monotonic() - began, what))
    return drawn


def _call(function: Callable[..., int], arguments: tuple) -> int:
    return function(*arguments)


_part, _sweep_part = make_part, make_sweep_part


def _attributes(system: AbstractSystem, protocol: str, renderer: str) -> dict[str, Any]:
    return {
        "system": system.name,
        "dt": system.dt,
        "state_names": system.state_names,
        "units": system.units,
        "input_names": system.input_names,
        "keypoints": system.keypoints,
        "generator": f"keycld {__version__}",
        "renderer": renderer,
        "protocol": protocol,
    }


def _assemble(system: AbstractSystem, plan: tuple[Split, ...], protocol: str, folder: Path) -> str:
    renderer = ""
    for split in plan:
        loaded = [np.load(folder / PARTIAL / name) for name, _ in _parts(split)]

        def joined(name: str, loaded=loaded) -> np.ndarray:
            return np.concatenate([part[name] for part in loaded])

        renderer = json.loads(loaded[0]["renderer"].item())
        attributes = _attributes(system, protocol, renderer)
        for key, value in asdict(split.conditions).items():
            attributes[key] = value
        write(
            folder / f"{split.name}.h5",
            Trajectories(
                time=loaded[0]["time"],
                input=joined("input").astype(np.float32),
                image=joined("image"),
                state=joined("state"),
                state_derivative=joined("state_derivative"),
                parameters={"seed": joined("seed"), "draws": joined("draws")},
                attributes={**attributes, "seed": split.seeds[0]},
            ),
        )
    _write_sweeps(system, folder, _attributes(system, protocol, renderer))
    return renderer


def _write_sweeps(system: AbstractSystem, folder: Path, attributes: dict[str, Any]) -> None:
    sweeps = system.sweeps()
    lengths = [len(sweep.state) for sweep in sweeps]
    longest = max(lengths)
    image = np.load(folder / PARTIAL / "sweeps.npz")["image"]
    # Shorter paths repeat their last point, so that one array holds all of them.
    index = np.minimum(np.arange(longest)[None, :], np.array(lengths)[:, None] - 1)
    starts = np.cumsum([0, *lengths[:-1]])
    states = np.concatenate([sweep.state for sweep in sweeps])
    shapes = [(*sweep.shape, 1)[:2] for sweep in sweeps]
    write(
        folder / "sweeps.h5",
        Trajectories(
            time=np.arange(1, longest + 1) * system.dt,
            input=np.zeros((len(sweeps), len(system.input_names)), np.float32),
            image=image[starts[:, None] + index],
            state=states[starts[:, None] + index],
            parameters={
                "name": np.array([sweep.name for sweep in sweeps]),
                "vary": np.array([",".join(sweep.vary) for sweep in sweeps]),
                "length": np.array(lengths),
                "shape": np.array(shapes),
            },
            attributes={**attributes, "seed": 0},
        ),
    )
