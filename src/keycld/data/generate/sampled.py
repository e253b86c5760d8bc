"""Data sets of sampled systems: the trajectories that they hold, and the work of one process."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from keycld._errors import KeycldError, unknown
from keycld._version import __version__
from keycld.data.format.trajectories import Trajectories
from keycld.data.format.writing import write
from keycld.data.generate.parts import Part
from keycld.data.generate.protocols import recording_counts, with_numbers
from keycld.systems import AbstractRenderedSystem, AbstractSampledSystem, Task

Store = Literal["states", "images"]
# Far enough apart that no two files share a number, and multiples of the windows of a simulation.
_FIRST_NUMBER = {"train": 0, "test": 2_100_000, "test_long": 4_200_000}
_FRAMES = {"train": 256, "test": 256, "test_long": 1000}
_MOST_VALIDATION = 1000


@dataclass(frozen=True)
class SampledSplit:
    """Trajectories of one file: `seeds` are their numbers (first, last + 1)."""

    name: str
    seeds: tuple[int, int]
    frames: int

    def __len__(self) -> int:
        """Return the number of trajectories."""
        return self.seeds[1] - self.seeds[0]


def sampled_splits(
    system: AbstractSampledSystem,
    size: str = "default",
    *,
    runs: Mapping[str, int] | None = None,
    frames: Mapping[str, int] | None = None,
) -> tuple[SampledSplit, ...]:
    """Return the files of a sampled system's data set.

    `validation` is the last 1,000 training trajectories, a tenth of them where there are fewer than 10,000. Where
    several trajectories are parts of one simulation, it is enlarged until no simulation is in both files.

    Args:
        system: the system.
        size: `"default"` or `"full"`.
        runs: numbers of trajectories by split; "train" counts those of validation too.
        frames: numbers of frames by split.

    Raises:
        KeycldError: an unknown size or split, or a number that is too small.

    Good values: the default sizes.
    """
    if size not in system.counts:
        raise unknown("size", size, system.counts)
    usual = system.counts[size]
    counts = recording_counts(usual, runs, dict.fromkeys(usual, 1) | {"train": 2}, system.name)
    lengths = {name: _FRAMES[name] for name in usual}
    lengths = with_numbers(lengths, frames, dict.fromkeys(usual, 3), "frames", system.name)
    kept = _border(system, size, counts["train"])
    splits = [
        SampledSplit("train", (0, kept), lengths["train"]),
        SampledSplit("validation", (kept, counts["train"]), lengths["train"]),
    ]
    for name in list(counts)[1:]:
        first = _FIRST_NUMBER[name]
        splits.append(SampledSplit(name, (first, first + counts[name]), lengths[name]))
    return tuple(splits)


def validation_count(train: int) -> int:
    """Return how many of `train` trajectories are for validation: 1,000, a tenth of fewer than 10,000."""
    return min(_MOST_VALIDATION, max(1, train // 10))


def _border(system: AbstractSampledSystem, size: str, train: int) -> int:
    """Return the number of the first validation trajectory among `train` numbers; a border between simulations."""
    related = system.related(size)
    if train <= related:
        raise KeycldError(
            f"{system.name} stores {related} recordings of each simulation (size {size}), and train and validation "
            f"share none: --train is at least {related + 1}, or {2 * related} for two whole simulations, not {train}."
        )
    return max(1, (train - validation_count(train)) // related) * related


def sampled_recipe(
    system: AbstractSampledSystem,
    *,
    protocol: str | None,
    size: str,
    store: Store | None,
    runs: Mapping[str, int] | None,
    frames: Mapping[str, int] | None,
) -> dict[str, Any]:
    """Return what decides the data set's contents.

    Raises:
        KeycldError: an unknown protocol, size or split, a bad number, or states where only MuJoCo can render them.
    """
    protocol = protocol or system.protocols[0]
    if protocol not in system.protocols:
        raise unknown("protocol", protocol, system.protocols, of=system.name)
    rendered = isinstance(system, AbstractRenderedSystem)
    if store == "states" and not rendered:
        raise KeycldError(f"{system.name} is rendered by MuJoCo, so its pictures are stored: leave out --store states.")
    return {
        "system": system.name,
        "protocol": protocol,
        "size": size,
        "store": "images" if store == "images" or not rendered else "states",
        "splits": [
            {**asdict(split), "conditions": {}} for split in sampled_splits(system, size, runs=runs, frames=frames)
        ],
    }


def sampled_parts(system: AbstractSampledSystem, recipe: Mapping[str, Any], partial: Path) -> list[Part]:
    """Return the work of a recipe, whose files go to the folder `partial`, split by split."""
    size, images = recipe["size"], recipe["store"] == "images"
    attributes = {
        "system": system.name,
        "dt": system.dt,
        "state_names": system.state_names,
        "units": system.units,
        "generator": f"keycld {__version__}",
        "protocol": recipe["protocol"],
        "size": size,
    }
    parts = []
    for split in recipe["splits"]:
        name, (begin, end), frames = split["name"], split["seeds"], split["frames"]
        related = system.related(size)
        group = math.ceil(system.group(frames, size, images) / related) * related
        # Groups begin at multiples and hold whole simulations, which are then computed once.
        edges = [begin, *range((begin // group + 1) * group, end, group), end]
        for first, last in zip(edges, edges[1:], strict=False):
            path = partial / f"{name}-{first:07d}.h5"
            marked = attributes | {"seed": begin}
            task = Task(make_sampled_part, (system, range(first, last), frames, images, marked, path))
            parts.append(Part(name, (last - first) * frames, path, task))
    return parts


def make_sampled_part(
    system: AbstractSampledSystem, numbers: range, frames: int, images: bool, attributes: Mapping[str, Any], path: Path
) -> None:
    """Write the trajectories of `numbers` to `path`, with their pictures or with the name of what renders them."""
    recording = system.record(numbers, frames, attributes["protocol"], attributes["size"])
    image, about = None, dict(attributes)
    if images:
        image, about["renderer"] = system.pictures(recording)
    elif isinstance(system, AbstractRenderedSystem):
        about |= {"renderer": system.renderer, "renderer_version": system.renderer_version}
    trajectories = Trajectories(
        time=recording.time,
        input=np.zeros((len(numbers), 0), np.float32),
        image=image,
        state=recording.state,
        parameters=recording.parameters,
        attributes=about,
    )
    write(path, trajectories)
