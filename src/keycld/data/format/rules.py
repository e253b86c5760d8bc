"""The rules of the file format: what is wrong, where, and the mend."""

from collections.abc import Iterator
from typing import Any

import h5py
import numpy as np

# h5py's items are unions of all that a file may hold, which no type checker can follow.
File = Any

SCHEMA_VERSION = 1
EVERY = slice(None)
_BLOCK = 1000
_ATTRIBUTES = {
    "schema_version": f"the number {SCHEMA_VERSION}",
    "system": "the name of what moves, or any word",
    "dt": "seconds between frames",
}
# Times are compared with k·dt to this part of a frame: cameras' clocks are read to a millisecond.
_TIME_TOLERANCE = 0.02


def check_structure(file: File, rows: slice = EVERY) -> list[str]:
    """What is wrong with all but the pixels of an open file; numbers are looked at in `rows` only."""
    problems = list(_attribute_problems(file)) + list(_field_problems(file))
    # Shapes are compared where every field is there and of the right kind, values where shapes agree.
    problems = problems or list(_shape_problems(file))
    return problems or list(_value_problems(file, rows))


def _attribute_problems(file: File) -> Iterator[str]:
    for name, meaning in _ATTRIBUTES.items():
        if name not in file.attrs:
            yield f"the root attribute '{name}' is missing: add it ({meaning})."
    version = file.attrs.get("schema_version", SCHEMA_VERSION)
    if not _is_number(version) or version != SCHEMA_VERSION:
        yield (
            f"the attribute 'schema_version' is {version}, but this keycld reads {SCHEMA_VERSION}: "
            "use the keycld that wrote the file, or correct the attribute."
        )
    dt = file.attrs.get("dt", 1.0)
    if not _is_number(dt) or not (np.isfinite(dt) and dt > 0):
        yield f"the attribute 'dt' must be a positive number of seconds, not {dt!r}."


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def _field_problems(file: File) -> Iterator[str]:
    for name, shape in {"time": "[T]", "input": "[N, l] or [N, T, l]"}.items():
        if name not in file:
            yield f"the field '/{name}' is missing: add it with shape {shape}."
    if "image" not in file:
        if "renderer" not in file.attrs or "state" not in file:
            yield (
                "the field '/image' is missing: add it (uint8 [N, T, H, W, 3]), or '/state' and the "
                "attributes 'renderer' and 'renderer_version' to draw it from."
            )
    elif _kind(file["image"]) != "uint8":
        yield f"'/image' is {_kind(file['image'])}, but must be uint8: store grey levels of 0 to 255."
    for name in ("time", "input", "state", "state_derivative"):
        if name in file and (not _is_real(file[name])):
            yield f"'/{name}' is {_kind(file[name])}, but must hold real numbers: store it as float64."


def _kind(item: Any) -> str:
    return str(item.dtype) if isinstance(item, h5py.Dataset) else "a group"


def _is_real(item: Any) -> bool:
    return isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu"


def _shape_problems(file: File) -> Iterator[str]:
    time, given = file["time"].shape, file["input"].shape
    if len(time) != 1 or time[0] < 2:
        yield f"'/time' has the shape {time}, but must be [T] with T of at least 2."
        return
    frames = time[0]
    if len(given) not in (2, 3) or given[0] < 1 or given[-1] < 1 or (len(given) == 3 and given[1] != frames):
        yield (
            f"'/input' has the shape {given}, but must be [N, l] or [N, T, l] with T = {frames} as in '/time' "
            "and l of at least 1 (zeros where nothing drives the motion)."
        )
        return
    trajectories = given[0]
    if "image" in file:
        shape = file["image"].shape
        if len(shape) != 5 or shape[:2] != (trajectories, frames) or shape[-1] != 3 or 0 in shape:
            yield (
                f"'/image' has the shape {shape}, but must be [N, T, H, W, 3] with N = {trajectories} as in "
                f"'/input' and T = {frames} as in '/time'."
            )
    for name in ("state", "state_derivative"):
        if name in file and (file[name].ndim != 3 or file[name].shape[:2] != (trajectories, frames)):
            yield f"'/{name}' has the shape {file[name].shape}, but must be [{trajectories}, {frames}, d]."
            return
    derivative = file["state_derivative"].shape if "state_derivative" in file else None
    if derivative is not None and ("state" not in file or file["state"].shape != derivative):
        yield "'/state_derivative' must come with a '/state' of the same shape: remove it or add the state."
    yield from _names_problems(file)
    for name, dataset in file.get("parameters", {}).items():
        if dataset.shape[:1] != (trajectories,):
            yield f"'/parameters/{name}' has the shape {dataset.shape}, but must be [{trajectories}, ...]."


def _names_problems(file: File) -> Iterator[str]:
    if "state" not in file:
        return
    for name in ("state_names", "units"):
        if name in file.attrs and len(np.atleast_1d(file.attrs[name])) != file["state"].shape[-1]:
            yield (
                f"the attribute '{name}' has {len(np.atleast_1d(file.attrs[name]))} entries, but '/state' has "
                f"{file['state'].shape[-1]} components: give one a component."
            )


def _value_problems(file: File, rows: slice) -> Iterator[str]:
    yield from _finite("/time", file["time"], EVERY)
    for name in ("input", "state", "state_derivative"):
        if name in file:
            yield from _finite(f"/{name}", file[name], rows)
    for name, dataset in file.get("parameters", {}).items():
        if dataset.dtype.kind == "f":
            yield from _finite(f"/parameters/{name}", dataset, rows)
    time, dt = np.asarray(file["time"], np.float64), float(file.attrs["dt"])
    steps = np.diff(time)
    if not np.all(np.isfinite(steps)):
        return
    if np.any(steps <= 0):
        k = int(np.argmax(steps <= 0))
        yield f"'/time' falls or stops from frame {k} ({time[k]:g} s) to {k + 1} ({time[k + 1]:g} s): sort it."
    elif np.any(np.abs(steps - dt) > _TIME_TOLERANCE * dt):
        k = int(np.argmax(np.abs(steps - dt)))
        yield (
            f"'/time' steps by {steps[k]:g} s from frame {k} to {k + 1}, but the attribute 'dt' is {dt:g} s: "
            "correct 'dt', or resample to equal steps."
        )


def _finite(name: str, dataset: Any, rows: slice) -> Iterator[str]:
    first, last, _ = rows.indices(len(dataset))
    count, where, value = 0, "", 0.0
    # Some rows at a time: a file may be larger than memory.
    for start in range(first, last, _BLOCK):
        values = np.asarray(dataset[start : min(start + _BLOCK, last)])
        bad = ~np.isfinite(values)
        if count == 0 and np.any(bad):
            index = np.unravel_index(int(np.argmax(bad)), bad.shape)
            value, where = values[index], ", ".join(str(int(i)) for i in (start + index[0], *index[1:]))
        count += int(bad.sum())
    if count:
        yield f"'{name}'[{where}] is {value} ({count} such values): remove the recording or mend the numbers."


def check_images(file: File) -> list[str]:
    """Which recordings' pictures cannot be decoded."""
    if "image" not in file:
        return []
    damaged: list[int] = []
    for index in range(len(file["image"])):
        try:
            file["image"][index]
        except OSError:
            damaged.append(index)
    if not damaged:
        return []
    some = ", ".join(str(index) for index in damaged[:5]) + (", ..." if len(damaged) > 5 else "")
    return [f"'/image' of recording {some} cannot be decoded, the file is damaged: copy or make it again."]
