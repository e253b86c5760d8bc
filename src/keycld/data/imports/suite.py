"""Imports the original files of "Which priors matter?"."""

import itertools
import os
import re
import shutil
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from keycld._errors import KeycldError, unknown
from keycld._lock import alone
from keycld.data.describe.finish import finish
from keycld.data.format.folder import PARTIAL, read_statistics
from keycld.data.format.trajectories import Trajectories
from keycld.data.format.writing import join, write
from keycld.data.generate.sampled import validation_count
from keycld.data.imports.claim import claim
from keycld.data.imports.tfrecord import Feature, count_records, read_examples, read_features
from keycld.systems import AbstractSampledSystem, get, names

_PART = 100
_LONG = "_long_trajectory"


def import_suite(folder: str | Path, out: str | Path | None = None) -> Path:
    """Read a folder of the published download, with features.txt, train.tfrecord and test.tfrecord.

    The name of the folder tells which set it is, for example `pendulum_colors`; a folder
    `pendulum_colors_long_trajectory` beside it becomes `test_long.h5`. The last 1,000 training trajectories become
    `validation.h5`, a tenth of them if there are fewer than 10,000. There is no input. Derivatives of the state are not
    imported, because those of the sets with friction lack the friction: `with_derivative` computes them.

    Args:
        folder: of the download.
        out: the folder to make; by default `data/NAME` with our name of the set, such as `data/toy/pendulum_colors`.

    Returns:
        The folder made.

    Raises:
        KeycldError: an unknown set, missing or damaged files, or a folder in use.
    """
    began = time.monotonic()
    # The name of `.` is that of the folder it stands for; a link keeps its own name.
    source = Path(os.path.abspath(folder))
    system = _system(source)
    out = Path(out) if out is not None else Path("data") / system.name
    with alone(out):
        if not _finished(out, system.name, source.name):
            _import(source, out, system, began)
        shutil.rmtree(out / PARTIAL, ignore_errors=True)
    return out


def _finished(out: Path, system: str, source: str) -> bool:
    """Tell whether an import of the same was killed after its last file, when only its parts were left to remove."""
    recipe = (read_statistics(out) or {}).get("recipe", {})
    same = recipe.get("system") == system and recipe.get("imported") == source
    return same and (out / PARTIAL).exists()


def _import(source: Path, out: Path, system: AbstractSampledSystem, began: float) -> None:
    claim(out)
    features = read_features(source / "features.txt")
    train = source / "train.tfrecord"
    count = count_records(train)
    if count < 2:
        raise KeycldError(f"{train} has {count} recordings, too few for training and validation: copy it again.")
    kept = count - validation_count(count)
    examples = read_examples(train, features)
    _write(out, "train", itertools.islice(examples, kept), system, features)
    _write(out, "validation", examples, system, features)
    _write(out, "test", read_examples(source / "test.tfrecord", features), system, features)
    long = source.with_name(source.name + _LONG)
    if long.is_dir():
        longer = read_features(long / "features.txt")
        _write(out, "test_long", read_examples(long / "test.tfrecord", longer), system, longer)
    recipe = {"system": system.name, "imported": source.name, "splits": []}
    finish(out, {"recipe": recipe, "seconds": round(time.monotonic() - began, 1)})


def _system(folder: Path) -> AbstractSampledSystem:
    name = re.sub(r"_dt_\d+_\d+$", "", folder.name)
    known = {each.split("/")[-1]: each for each in names(AbstractSampledSystem)}
    if name not in known:
        raise unknown("data set", name, known, of="the suite", listed="docs/datasets.md")
    system = get(known[name])
    assert isinstance(system, AbstractSampledSystem)
    return system


def _write(
    out: Path,
    name: str,
    examples: Iterator[dict[str, np.ndarray]],
    system: AbstractSampledSystem,
    features: Mapping[str, Feature],
) -> None:
    parts = []
    while block := list(itertools.islice(examples, _PART)):
        parts.append(out / PARTIAL / f"{name}-{len(parts):05d}.h5")
        write(parts[-1], _trajectories(block, system, features))
    if not parts:
        raise KeycldError(f"there are no trajectories for {name}.h5: copy the download again.")
    join(parts, out / f"{name}.h5")


def _trajectories(
    examples: list[dict[str, np.ndarray]], system: AbstractSampledSystem, features: Mapping[str, Feature]
) -> Trajectories:
    def stacked(name: str) -> Any:
        return np.stack([example[name] for example in examples])

    state = stacked("x")
    return Trajectories(
        time=system.dt * np.arange(state.shape[1]),
        input=np.zeros((len(state), 0), np.float32),
        image=stacked("image"),
        state=state,
        # Parameters have a leading axis of length one.
        parameters={name[6:]: stacked(name)[:, 0] for name in features if name.startswith("other/")},
        attributes={
            "system": system.name,
            "dt": system.dt,
            "state_names": system.state_names,
            "units": system.units,
            "generator": "dm_hamiltonian_dynamics_suite",
            "protocol": "published",
            "renderer": "the suite's own",
        },
    )
