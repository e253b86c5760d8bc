"""Makes a data set, or the split of one that is made when it is first needed."""

import os
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from keycld._errors import KeycldError
from keycld._lock import alone
from keycld._progress import Bar
from keycld.data.format.folder import PARTIAL
from keycld.data.generate.job import Job, Made, Progress
from keycld.data.generate.recipes import ON_DEMAND, deferred, recipe_for, stored_recipe
from keycld.data.generate.sampled import Store
from keycld.systems import AbstractSampledSystem, AbstractSystem, check_workers, get, names


class ProgressBar:
    """A `progress` callback of `make_data` that shows a bar with the given `name`."""

    def __init__(self, name: str = "data"):
        self._name = name
        self._bar: Bar | None = None

    def __call__(self, progress: Progress) -> None:
        """Update the bar."""
        if self._bar is None:
            self._bar = Bar(self._name, progress.total)
        self._bar.show(progress.done, progress.fresh / max(progress.seconds, 1e-9), "")


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
    all: bool = False,
    workers: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Made:
    """Make the data set of a system (`docs/data.md`, `docs/datasets.md`).

    The same arguments give the same numbers, for any number of workers and interruptions; pictures depend on the GL
    driver too. Unfinished work stays in `OUT/.partial`, and the same call resumes it. Finished data are left as they
    are. Of two calls for one folder, the second waits. `/input` holds the inputs that act in the set, and none of the
    others.

    `test_long.h5` of a system with motors is made when a `DataSet` is first asked for it, with the same contents.

    Args:
        system: a name of `keycld.systems.names()`, or a system.
        out: the folder; by default `data/NAME`.
        protocol: `"keycld-2022"` (arXiv v1), `"keycld-2024"` (journal version) or `"zoo"` for a mechanism, by default
            the system's own: `"zoo"` for `zoo/…`, otherwise `"keycld-2022"`; of a set of "Which priors matter?" one of
            the system's `protocols`, by default the first.
        control: which inputs act, instead of the protocol's choice. In test_long they are zero.
        initial_state: how runs begin, instead of the protocol's choice; not in test_long.
        clip: whether the motors limit the input, instead of the protocol's choice.
        input: "constant" in a run (every protocol's choice) or a "random-walk"; not in test_long.
        size: "full" is the published size; "default" is smaller where that takes hours (`docs/datasets.md`).
        store: "states", rendered when they are read, or "images"; by default states wherever a picture is a function
            of the state.
        runs: numbers of runs by split, for small sets: `{"train": 2, "test": 1}`. By default test_long has no more of
            them than test.
        frames: numbers of frames of a run by split.
        all: make test_long of a system with motors now too.
        workers: renderer processes, at most four; by default one a core.
        progress: called after each part; `ProgressBar()` shows a bar.

    Raises:
        KeycldError: an unknown name or a bad number; a folder that cannot be written, or that holds other data; a full
            disk; no GL.

    Good values: the defaults. 27,580 frames take about a minute on two cores without a GPU, twice as long with `all`.
    """
    check_workers(workers)
    system = get(system) if isinstance(system, str) else system
    folder = Path(out) if out is not None else Path("data") / system.name
    recipe = recipe_for(
        system,
        protocol=protocol,
        control=control,
        initial_state=initial_state,
        clip=clip,
        input=input,
        size=size,
        store=store,
        runs=runs,
        frames=frames,
    )
    # In sampled sets test_long is a hundredth of the data.
    now = ON_DEMAND if all or isinstance(system, AbstractSampledSystem) else ()
    job = Job(system, folder, recipe, now, time.monotonic())
    # Finished data may lie where nothing can be written, so they are recognised without the lock.
    if job.finished() and not (folder / PARTIAL).exists():
        return job.made(False, 0)
    job.refuse_others()
    with alone(folder):
        return job.run(workers, progress)


def provide(file: Path) -> None:
    """Make a file of a data set that `make_data` left for when it is needed, with a line and a bar on stderr.

    Other files, and those that are there, are left alone. What an interrupted call has left is used, and a second
    process waits for the first.

    Raises:
        KeycldError: the folder may not be written, or its system is not registered; and as `make_data`.
    """
    folder, name = file.parent, file.stem
    if file.exists() or file.suffix != ".h5" or name not in deferred(folder):
        return
    recipe = stored_recipe(folder)
    assert recipe is not None
    if not os.access(folder, os.W_OK):
        raise KeycldError(
            f"{file} is made when it is first needed, but {folder} may not be written: copy the folder to a place "
            "where you may write, and use the copy."
        )
    if recipe["system"] not in names():
        raise KeycldError(
            f"{file} is made when it is first needed, but no system '{recipe['system']}' is registered: import the "
            "module that registers it."
        )
    with alone(folder):
        if file.exists():
            return
        [split] = [each for each in recipe["splits"] if each["name"] == name]
        count = split["seeds"][1] - split["seeds"][0]
        print(f"making {file}, which is needed now: {count} × {split['frames']} frames", file=sys.stderr, flush=True)
        Job(get(recipe["system"]), folder, recipe, (name,), time.monotonic()).run(None, ProgressBar(name))
