"""What decides the contents of a data set: its recipe, JSON values, kept in `statistics.json`."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from keycld._errors import KeycldError
from keycld._version import __version__
from keycld.data.format.folder import PARTIAL, read_recipe, read_statistics
from keycld.data.generate.parts import Part, make_part
from keycld.data.generate.protocols import Split, splits
from keycld.data.generate.sampled import Store, sampled_parts, sampled_recipe
from keycld.data.generate.sweeps import make_sweeps
from keycld.systems import AbstractMechanism, AbstractSampledSystem, AbstractSystem, Conditions, Task

# Splits that are made when they are first needed: half of the pictures that MuJoCo renders, and no training reads them.
ON_DEMAND = ("test_long",)
# Frames of a part: some seconds of rendering on a CPU, the most that a kill loses.
_PART_FRAMES = 500


def recipe_for(
    system: AbstractSystem,
    *,
    protocol: str | None,
    control: str | None,
    initial_state: str | None,
    clip: bool | None,
    input: str | None,
    size: str,
    store: Store | None,
    runs: Mapping[str, int] | None,
    frames: Mapping[str, int] | None,
) -> dict[str, Any]:
    """Return the recipe of these settings, which `keycld.data.make_data` describes.

    Raises:
        KeycldError: an unknown name, a bad number, or a setting that the system does not have.
    """
    if isinstance(system, AbstractSampledSystem):
        if not (control is initial_state is clip is input is None):
            raise KeycldError(f"{system.name} has no motors: leave out --control, --initial-state, --clip and --input.")
        recipe = sampled_recipe(system, protocol=protocol, size=size, store=store, runs=runs, frames=frames)
    else:
        assert isinstance(system, AbstractMechanism)
        if size != "default" or store == "states":
            raise KeycldError(
                f"{system.name} has one size and pictures that MuJoCo renders: leave out --size and --store."
            )
        protocol = protocol or system.protocol
        plan = splits(
            protocol, control=control, initial_state=initial_state, clip=clip, input=input, runs=runs, frames=frames
        )
        for split in plan:
            begins = split.conditions.initial_state
            if initial_state is None and begins not in system.initial_states:
                raise KeycldError(
                    f"protocol {protocol} begins with the initial state '{begins}', which {system.name} does not have: "
                    f"leave out --protocol, or choose an --initial-state from {', '.join(system.initial_states)}."
                )
            system.check(split.conditions)
        described = [asdict(split) | {"conditions": split.conditions.described()} for split in plan]
        recipe = {"system": system.name, "protocol": protocol, "splits": described}
    return _plain(recipe)


def parts_of(system: AbstractSystem, recipe: Mapping[str, Any], partial: Path) -> list[Part]:
    """Return the work of a recipe, whose files go to the folder `partial`, split by split."""
    if isinstance(system, AbstractSampledSystem):
        return sampled_parts(system, recipe, partial)
    assert isinstance(system, AbstractMechanism)
    plan = [
        Split(**{**split, "seeds": tuple(split["seeds"]), "conditions": Conditions(**split["conditions"])})
        for split in recipe["splits"]
    ]
    attributes = {
        "system": system.name,
        "dt": system.dt,
        "state_names": system.state_names,
        "units": system.units,
        # Of all files: in test_long, where no input acts, those of the other files are zero.
        "input_names": _acting(system, plan[0].conditions.control),
        "generator": f"keycld {__version__}",
        "protocol": recipe["protocol"],
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


def stored_recipe(folder: Path) -> dict[str, Any] | None:
    """Return the recipe of a folder that `make_data` finished; None for other data.

    Raises:
        KeycldError: `statistics.json` is damaged.
    """
    found = (read_statistics(folder) or {}).get("recipe")
    return _renamed(found) if isinstance(found, dict) else None


def deferred(folder: Path) -> tuple[str, ...]:
    """Name the splits of a finished folder that `make_data` left for when they are first needed.

    Raises:
        KeycldError: `statistics.json` is damaged.
    """
    plan = [split["name"] for split in (stored_recipe(folder) or {}).get("splits", [])]
    return tuple(name for name in ON_DEMAND if name in plan and not (folder / f"{name}.h5").exists())


def begun_recipe(folder: Path) -> dict[str, Any] | None:
    """Return the recipe of work that is under way or was interrupted in a folder; None if there is none."""
    found = read_recipe(folder / PARTIAL / "recipe.json")
    return None if found is None else _renamed(found)


def refuse_another(wanted: Mapping[str, Any], found: Mapping[str, Any] | None, folder: Path) -> None:
    """Refuse to mix data of two recipes in a folder.

    Raises:
        KeycldError: the recipes differ; it says in what.
    """
    other = found or {}
    if wanted == other:
        return
    changed = [key for key in wanted if key != "splits" and wanted[key] != other.get(key)]
    changed += _changed_settings(wanted["splits"], other.get("splits", []))
    raise KeycldError(
        f"{folder} holds data made with another {' and '.join(changed)}: choose another folder, or delete it."
    )


def _acting(system: AbstractMechanism, control: str) -> tuple[str, ...]:
    """Name the inputs that act in a control mode (`Conditions.control`)."""
    modes = {"none": (), "under": system.input_names[:1], "full": system.input_names}
    return modes.get(control, (control,))


def _plain(value: Any) -> Any:
    """Convert a value to what JSON gives back (tuples become lists), so that it can be compared."""
    return json.loads(json.dumps(value))


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
    words = {"seeds": "number of recordings", "frames": "number of frames"}
    return [words.get(key, key) for key in dict.fromkeys(changed)]
