"""The work of making data: in parallel, resumed after an interruption, by one process at a time."""

import contextlib
import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from keycld._errors import KeycldError
from keycld._files import make_folder, write_text
from keycld.data.describe.finish import describe_more, finish
from keycld.data.format.folder import PARTIAL, read_statistics, refuse_foreign
from keycld.data.format.reading import read
from keycld.data.format.writing import join
from keycld.data.generate.recipes import ON_DEMAND, begun_recipe, deferred, parts_of, refuse_another, stored_recipe
from keycld.systems import AbstractRenderedSystem, AbstractSystem, run_in_processes

# Seconds for a part that JAX renders, which cannot hang as GL can; molecular dynamics simulates for many minutes.
_PATIENT = 4 * 3600.0


@dataclass(frozen=True)
class Progress:
    """The progress of a long job.

    Attributes:
        done: frames that exist.
        total: frames of all files that the job makes.
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
        frames: rendered in this call; fewer than those of the files if the call resumed an interrupted one.
        seconds: of this call.
        renderer: what rendered the pictures, for example the name of the GL renderer.
        later: splits that are made when they are first needed.
    """

    folder: Path
    fresh: bool
    frames: int
    seconds: float
    renderer: str
    later: tuple[str, ...]


class Job:
    """The work of one call.

    Args:
        system: the system.
        folder: of the data.
        recipe: what decides their contents.
        now: the splits of `ON_DEMAND` to make.
        began: moment of the call.
    """

    def __init__(self, system: AbstractSystem, folder: Path, recipe: dict[str, Any], now: Sequence[str], began: float):
        self._folder, self._recipe, self._now, self._began = folder, recipe, now, began
        self._parts = parts_of(system, recipe, folder / PARTIAL)
        self._patience = {"time_out": _PATIENT} if isinstance(system, AbstractRenderedSystem) else {}

    def finished(self) -> bool:
        """Tell whether the folder holds exactly these data; raise if it holds others."""
        if read_statistics(self._folder) is None:
            return False
        refuse_another(self._recipe, stored_recipe(self._folder), self._folder)
        return not self._missing()

    def refuse_others(self) -> None:
        """Raise if the folder holds data from elsewhere, or unfinished data of another recipe."""
        begun = begun_recipe(self._folder)
        if begun is not None:
            refuse_another(self._recipe, begun, self._folder)
            return
        taken = sorted(path.name for path in self._folder.glob("*.h5"))
        if taken and read_statistics(self._folder) is None:
            raise KeycldError(f"{self._folder} already holds {taken[0]} from elsewhere: choose another folder.")

    def made(self, fresh: bool, frames: int) -> Made:
        """Return the outcome, from what describes the folder."""
        renderer = (read_statistics(self._folder) or {}).get("renderer", "")
        later = deferred(self._folder)
        return Made(self._folder, fresh, frames, time.monotonic() - self._began, renderer, later)

    def run(self, workers: int | None, progress: Callable[[Progress], None] | None) -> Made:
        """Make what is missing; the caller holds the folder's lock."""
        folder, partial = self._folder, self._folder / PARTIAL
        self.refuse_others()
        if self.finished():
            shutil.rmtree(partial, ignore_errors=True)
            return self.made(False, 0)
        missing = self._missing()
        refuse_foreign(folder, ("README.md", "preview.gif"))
        make_folder(partial)
        write_text(partial / "recipe.json", json.dumps(self._recipe))
        if read_statistics(folder) is not None and set(missing) <= set(ON_DEMAND):
            # The rest of the set is complete, and stays in use meanwhile.
            frames = self._make([name for name in missing if not self._file(name).exists()], workers, progress)
            describe_more(folder, missing, time.monotonic() - self._began, frames)
        else:
            (folder / "statistics.json").unlink(missing_ok=True)
            frames = self._make(self._wanted(), workers, progress)
            renderer = read(self._file("train"), images=False, rows=slice(0, 1)).attributes["renderer"]
            seconds = round(time.monotonic() - self._began, 1)
            made = {"recipe": self._recipe, "renderer": renderer, "seconds": seconds, "frames_drawn": frames}
            finish(folder, made)
        shutil.rmtree(partial)
        return self.made(True, frames)

    def _file(self, name: str) -> Path:
        return self._folder / f"{name}.h5"

    def _wanted(self) -> list[str]:
        """List all splits except those for later; one that is there, was begun or was lost is not for later."""
        begun = {part.split for part in self._parts if part.path.exists()}
        now = {*self._now, *begun, *self._described()}
        later = [name for name in ON_DEMAND if name not in now and not self._file(name).exists()]
        return [name for name in dict.fromkeys(part.split for part in self._parts) if name not in later]

    def _missing(self) -> list[str]:
        """List the wanted splits without a file, or that the statistics of the folder do not describe."""
        described = self._described()
        return [name for name in self._wanted() if name not in described or not self._file(name).exists()]

    def _described(self) -> dict[str, Any]:
        return (read_statistics(self._folder) or {}).get("splits", {})

    def _make(self, names: Sequence[str], workers: int | None, progress: Callable[[Progress], None] | None) -> int:
        """Make the files of splits and return how many frames were rendered; parts that exist are used."""
        parts = [part for part in self._parts if part.split in names]
        missing = [part for part in parts if not part.path.exists()]
        total, fresh = sum(part.frames for part in parts), 0
        already = total - sum(part.frames for part in missing)
        # Closed at once when `progress` raises, so that no worker outlives the call.
        tasks = [part.task for part in missing]
        with contextlib.closing(run_in_processes(tasks, workers=workers, **self._patience)) as results:
            for index, _ in results:
                fresh += missing[index].frames
                if progress is not None:
                    seconds = time.monotonic() - self._began
                    progress(Progress(already + fresh, total, fresh, seconds, missing[index].split))
        for name in names:
            join([part.path for part in parts if part.split == name], self._file(name))
        return fresh
