"""The validator: what is wrong in a file or a folder."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from keycld._errors import KeycldError
from keycld.data.format.folder import CONSTRAINTS, read_statistics, sha256, unfinished
from keycld.data.format.hdf5 import open_file
from keycld.data.format.rules import check_images, check_structure


def check(path: str | Path) -> list[str]:
    """List what is wrong with a file, or with all files of a folder; an empty list if nothing is.

    Every picture is decoded, one recording at a time. In a folder that `keycld data make` finished, the check-sums are
    compared too. A `constraints.toml` is read as training would.
    """
    path = Path(path)
    if path.is_dir():
        return list(_check_folder(path))
    try:
        with open_file(path) as file:
            problems = check_structure(file) or check_images(file)
    except KeycldError as error:
        return [str(error)]
    return [f"{path}: {problem}" for problem in problems]


def _disagreements(files: list[Path]) -> Iterator[str]:
    """Yield what must be the same in all files of a folder and is not."""
    found: dict[str, tuple[Any, Path]] = {}
    for path in files:
        with open_file(path) as file:
            inputs = file["input"].shape[-1] if "input" in file else 0
            facts = {"system": file.attrs["system"], "dt": float(file.attrs["dt"]), "inputs": inputs}
            if "image" in file:
                facts["size of a picture"] = file["image"].shape[2:4]
        for name, value in facts.items():
            first, where = found.setdefault(name, (value, path))
            if value != first:
                yield (
                    f"{path} differs from {where.name} in '{name}': {value}, not {first}; "
                    "all files of a folder must show the same system, so make or import one of them again."
                )


def _check_folder(folder: Path) -> Iterator[str]:
    files = sorted(folder.glob("*.h5"))
    if not files:
        yield f"{folder} holds no .h5 file: make or import data there first."
    if unfinished(folder):
        yield f"{folder} is unfinished: run the command that made it once more."
    if not files:
        return
    problems = [problem for file in files for problem in check(file)]
    yield from problems or _disagreements(files)
    if (folder / CONSTRAINTS).exists():
        from keycld.mechanics import load_constraints

        try:
            load_constraints(folder / CONSTRAINTS)
        except KeycldError as error:
            yield str(error)
    try:
        stored = read_statistics(folder) or {}
    except KeycldError as error:
        yield str(error)
        return
    for name, figures in {**dict.fromkeys(("train", "validation", "test")), **stored.get("splits", {})}.items():
        file = folder / f"{name}.h5"
        if not file.exists():
            yield f"{folder} lacks {file.name}: make the data again, or add the file."
        elif figures is not None and figures["sha256"] != sha256(file):
            yield f"{file} has changed since it was made: its check-sum differs from that in statistics.json."
