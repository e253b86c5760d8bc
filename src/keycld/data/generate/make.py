"""Makes a data set: every split of a protocol and the sweeps, in parallel; an interrupted call is resumed."""

import contextlib
import json
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from keycld._errors import KeycldError
from keycld._files import make_folder, write_text
from keycld._version import __version__
from keycld.data.describe.finish import finish
from keycld.data.format.folder import PARTIAL, read_statistics
from keycld.data.format.reading import read
from keycld.data.format.writing import join
from keycld.data.generate.parts import Part, make_part
from keycld.data.generate.protocols import PROTOCOLS, Split, splits
from keycld.data.generate.sampled import Store, sampled_job
from keycld.data.generate.sweeps import make_sweeps
from keycld.systems import (
    AbstractMechanism,
    AbstractRenderedSystem,
    AbstractSampledSystem,
    AbstractSystem,
    Task,
    get,
    run_in_processes,
)

# Frames of a part: some seconds of rendering on a CPU, the most that a kill loses.
_PART_FRAMES = 500
# Seconds for a part that JAX renders, which cannot hang as GL can; molecular dynamics simulates for many minutes.
_PATIENT = 4 * 3600.0


@dataclass(frozen=True)
class Progress:
    """The progress of a long job.

    Attributes:
        done: frames that exist.
        total: frames of the whole set.
        fresh: frames of `done` rendered in this call; `fresh / seconds` is the speed.
        seconds: since the call.
        what: the split of the last part.
    """

    done: int
    total: int
    fresh: int
    seconds: float
    what: str


@dataclass(frozen=True)
class Made:
    """The outcome of `make_data`.

    Attributes:
        folder: where the data are.
        fresh: False if the finished data were there already.
        frames: rendered in this call; fewer than those of the set if the call resumed an interrupted one.
        seconds: of this call.
        renderer: what rendered the pictures, for example the name of the GL renderer.
    """

    folder: Path
    fresh: bool
    frames: int
    seconds: float
    renderer: str


def make_data(
    system: str | AbstractSystem,
    out: str | Path | None = None,
    *,
    protocol: str | None = None,
    control: str | None = None,
    initial_state: str | None = None,
    clip: bool | None = None,
    input: str | None = None,
    size: str = "default",
    store: Store | None = None,
    runs: Mapping[str, int] | None = None,
    frames: Mapping[str, int] | None = None,
    workers: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Made:
    """Make the data set of a system (`docs/data.md`, `docs/datasets.md`).

    The same arguments give the same numbers, for any number of workers and interruptions; pictures depend on the GL
    driver too. Unfinished work stays in `OUT/.partial`, and the same call resumes it. Finished data are left as they
    are. `/input` holds the inputs that act in the set, and none of the others.

    Args:
        system: a name of `keycld.systems.names()`, or a system.
        out: the folder; by default `data/NAME`.
        protocol: of a system with motors `"keycld-2022"` (arXiv v1, the default) or `"keycld-2024"` (journal version);
            of a set of "Which priors matter?" one of the system's `protocols`, by default the first.
        control: which inputs act, instead of the protocol's choice. In test_long they are zero.
        initial_state: how runs begin, instead of the protocol's choice; not in test_long.
        clip: whether the motors limit the input, instead of the protocol's choice.
        input: "constant" in a run (every protocol's choice) or a "random-walk"; not in test_long.
        size: "full" is the published size; "default" is smaller where that takes hours (`docs/datasets.md`).
        store: "states", rendered when they are read, or "images"; by default states wherever a picture is a function
            of the state.
        runs: numbers of runs by split, for small sets: `{"train": 2, "test": 1}`.
        frames: numbers of frames of a run by split.
        workers: renderer processes, at most four; by default one a core.
        progress: called after each part.

    Raises:
        KeycldError: an unknown name or a bad number; a folder that cannot be written, or that holds other data; a full
            disk; no GL.

    Good values: the defaults. 52,900 frames take two to three minutes on two cores without a GPU.
    """
    began = time.monotonic()
    system = get(system) if isinstance(system, str) else system
    folder = Path(out) if out is not None else Path("data") / system.name
    if isinstance(system, AbstractSampledSystem):
        if not (control is initial_state is clip is input is None):
            raise KeycldError(f"{system.name} has no motors: leave out control, initial_state, clip and input.")
        recipe, parts = sampled_job(
            system, folder / PARTIAL, protocol=protocol, size=size, store=store, runs=runs, frames=frames
        )
    else:
        assert isinstance(system, AbstractMechanism)
        if size != "default" or store == "states":
            raise KeycldError(f"{system.name} has one size and pictures that MuJoCo renders: leave out size and store.")
        protocol = protocol or PROTOCOLS[0]
        plan = splits(
            protocol, control=control, initial_state=initial_state, clip=clip, input=input, runs=runs, frames=frames
        )
        for split in plan:
            system.check(split.conditions)
        described = [asdict(split) | {"conditions": split.conditions.described()} for split in plan]
        recipe = {"system": system.name, "protocol": protocol, "splits": described}
        parts = _parts(system, plan, protocol, folder / PARTIAL)
    recipe = _plain(recipe)
    names = tuple(dict.fromkeys(part.split for part in parts))
    if _finished(folder, recipe, names):
        shutil.rmtree(folder / PARTIAL, ignore_errors=True)
        renderer = (read_statistics(folder) or {}).get("renderer", "")
        return Made(folder, False, 0, time.monotonic() - began, renderer)
    _begin(folder, recipe)
    patience = {"time_out": _PATIENT} if isinstance(system, AbstractRenderedSystem) else {}
    rendered = _render(parts, workers, progress, began, patience)
    for name in names:
        join([part.path for part in parts if part.split == name], folder / f"{name}.h5")
    renderer = read(parts[0].path, images=False, rows=slice(0, 1)).attributes["renderer"]
    seconds = time.monotonic() - began
    made = {"recipe": recipe, "renderer": renderer, "seconds": round(seconds, 1), "frames_drawn": rendered}
    finish(folder, made)
    shutil.rmtree(folder / PARTIAL)
    return Made(folder, True, rendered, time.monotonic() - began, renderer)


def _plain(value: Any) -> Any:
    """Convert a value to what JSON gives back (tuples become lists), so that it can be compared."""
    return json.loads(json.dumps(value))


def _finished(folder: Path, recipe: dict[str, Any], names: Sequence[str]) -> bool:
    """Tell whether the folder holds exactly these data; raise if it holds others."""
    found = read_statistics(folder)
    if found is None:
        return False
    _same(recipe, found.get("recipe"), folder)
    return all((folder / f"{name}.h5").exists() for name in names)


def _same(wanted: dict[str, Any], found: Any, folder: Path) -> None:
    other = _renamed(found) if isinstance(found, dict) else {}
    if wanted == other:
        return
    changed = [key for key in wanted if key != "splits" and wanted[key] != other.get(key)]
    changed += _changed_settings(wanted["splits"], other.get("splits", []))
    raise KeycldError(
        f"{folder} holds data made with another {' and '.join(changed)}: choose another folder, or delete it."
    )


def _renamed(recipe: dict[str, Any]) -> dict[str, Any]:
    """Return a recorded recipe with today's names: `initial_state` was once `start`."""
    recipe = _plain(recipe)
    for split in recipe.get("splits", []):
        if "start" in split.get("conditions", {}):
            split["conditions"]["initial_state"] = split["conditions"].pop("start")
    return recipe


def _changed_settings(wanted: Sequence[dict[str, Any]], found: Sequence[dict[str, Any]]) -> list[str]:
    changed: list[str] = []
    for new, old in zip(wanted, found, strict=False):
        flat_new, flat_old = new | new["conditions"], old | old.get("conditions", {})
        keys = [key for key in flat_new | flat_old if key != "conditions"]
        changed += [key for key in keys if flat_new.get(key) != flat_old.get(key)]
    words = {"seeds": "number of runs", "frames": "number of frames"}
    return [words.get(key, key) for key in dict.fromkeys(changed)]


def _begin(folder: Path, recipe: dict[str, Any]) -> None:
    """Claim the folder for these data, or resume what an interrupted call left."""
    marker = folder / PARTIAL / "recipe.json"
    if marker.exists():
        _same(recipe, json.loads(marker.read_text()), folder)
        return
    taken = sorted(path.name for path in folder.glob("*.h5"))
    if taken and read_statistics(folder) is None:
        raise KeycldError(f"{folder} already holds {taken[0]} from elsewhere: choose another folder.")
    make_folder(marker.parent)
    (folder / "statistics.json").unlink(missing_ok=True)
    write_text(marker, json.dumps(recipe))


def _acting(system: AbstractMechanism, control: str) -> tuple[str, ...]:
    """Name the inputs that act in a control mode (`Conditions.control`)."""
    modes = {"none": (), "under": system.input_names[:1], "full": system.input_names}
    return modes.get(control, (control,))


def _parts(system: AbstractMechanism, plan: Sequence[Split], protocol: str, partial: Path) -> list[Part]:
    attributes = {
        "system": system.name,
        "dt": system.dt,
        "state_names": system.state_names,
        "units": system.units,
        # Of all files: in test_long, where no input acts, those of the other files are zero.
        "input_names": _acting(system, plan[0].conditions.control),
        "generator": f"keycld {__version__}",
        "protocol": protocol,
    }
    parts = []
    for split in plan:
        size = max(1, _PART_FRAMES // split.frames)
        for first in range(*split.seeds, size):
            seeds = tuple(range(first, min(first + size, split.seeds[1])))
            path = partial / f"{split.name}-{first:05d}.h5"
            task = Task(make_part, (system, split, seeds, attributes, path))
            parts.append(Part(split.name, len(seeds) * split.frames, path, task))
    path = partial / "sweeps.h5"
    frames = sum(len(sweep.state) for sweep in system.sweeps())
    return [*parts, Part("sweeps", frames, path, Task(make_sweeps, (system, attributes, path)))]


def _render(
    parts: Sequence[Part],
    workers: int | None,
    progress: Callable[[Progress], None] | None,
    began: float,
    patience: Mapping[str, float],
) -> int:
    missing = [part for part in parts if not part.path.exists()]
    total, fresh = sum(part.frames for part in parts), 0
    already = total - sum(part.frames for part in missing)
    # Closed at once when `progress` raises, so that no worker outlives the call.
    tasks = [part.task for part in missing]
    with contextlib.closing(run_in_processes(tasks, workers=workers, **patience)) as results:
        for index, _ in results:
            fresh += missing[index].frames
            if progress is not None:
                progress(Progress(already + fresh, total, fresh, time.monotonic() - began, missing[index].split))
    return fresh
