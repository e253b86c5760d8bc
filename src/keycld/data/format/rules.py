"""The rules of the file format: what is wrong, where, and how to fix it."""

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
    "system": "the name of the system, or any word",
    "dt": "seconds between frames",
}
# Steps of time may differ from dt by this part of it: the clocks of cameras are read to a millisecond.
_TIME_TOLERANCE = 0.02
LARGEST_RECORDING = 128_000_000
"""The most bytes of the pictures, or of one other field, of a recording: 128 frames of 576 × 576 pixels."""
_LONGEST_SIDE = 2048


def check_structure(file: File, rows: slice = EVERY) -> list[str]:
    """List the violations in all but the pixels of an open file; values are checked in `rows` only."""
    problems = list(_attribute_problems(file)) + list(_field_problems(file))
    # Shapes are compared only if every field is there and of the right kind, values only if the shapes agree.
    problems = problems or list(_shape_problems(file))
    return problems or check_values(file, rows)


def check_values(file: File, rows: slice) -> list[str]:
    """List the violations in the values of some rows of a file whose structure is right."""
    return list(_value_problems(file, rows))


def _attribute_problems(file: File) -> Iterator[str]:
    for name, meaning in _ATTRIBUTES.items():
        if name not in file.attrs:
            yield f"the root attribute '{name}' is missing: add it ({meaning})."
    for name in ("system", "renderer", "protocol", "generator"):
        value = file.attrs.get(name, "")
        if not isinstance(value, str) or len(value) > 1000:
            yield f"the attribute '{name}' is not a text: store one of at most 1,000 letters."
    for name in ("state_names", "units", "input_names"):
        if not all(isinstance(each, str) for each in np.atleast_1d(file.attrs.get(name, ())).tolist()):
            yield f"the attribute '{name}' holds something else than texts: store a list of them."
    version = file.attrs.get("schema_version", SCHEMA_VERSION)
    if not _is_number(version) or version != SCHEMA_VERSION:
        yield (
            f"the attribute 'schema_version' is {version}, but this keycld reads {SCHEMA_VERSION}: "
            "use the keycld that wrote the file, or correct the attribute."
        )
    dt = file.attrs.get("dt", 1.0)
    if not _is_number(dt) or not (np.isfinite(dt) and dt > 0):
        yield f"the attribute 'dt' must be a positive number of seconds, not {dt}."


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def _field_problems(file: File) -> Iterator[str]:
    if "time" not in file:
        yield "the field '/time' is missing: add it with shape [T]."
    if "image" not in file:
        if "renderer" not in file.attrs or "state" not in file:
            yield (
                "the field '/image' is missing: add it (uint8 [N, T, H, W, 3]), or '/state' and the "
                "attributes 'renderer' and 'renderer_version' to render it from."
            )
    elif _kind(file["image"]) != "uint8":
        yield f"'/image' is {_kind(file['image'])}, but must be uint8: store grey levels of 0 to 255."
    for name in ("time", "input", "state", "state_derivative"):
        if name in file and (not _is_real(file[name])):
            yield f"'/{name}' is {_kind(file[name])}, but must hold real numbers: store it as float64."
    parameters = file.get("parameters", {})
    if _kind(parameters) != "a group" and len(parameters):
        yield "'/parameters' is not a group: store each parameter as '/parameters/NAME'."
        return
    for name, item in parameters.items():
        if _kind(item) == "a group" or (item.dtype.kind not in "fiubSO"):
            yield f"'/parameters/{name}' is {_kind(item)}, but must hold numbers or texts."


def _kind(item: Any) -> str:
    return str(item.dtype) if isinstance(item, h5py.Dataset) else "a group"


def _is_real(item: Any) -> bool:
    return isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu"


def recordings_in(file: File) -> int:
    """Count the recordings of an open file: `/input` may be absent, but not both `/image` and `/state`."""
    shape = next(file[name].shape for name in ("input", "image", "state") if name in file)
    return shape[0] if shape else 0


def _shape_problems(file: File) -> Iterator[str]:
    for name in ("image", "input", "state", "state_derivative"):
        shape = file[name].shape if name in file else ()
        largest = np.prod(shape[1:], dtype=float) * (file[name].dtype.itemsize if name in file else 0)
        if largest > LARGEST_RECORDING or (name == "image" and max(shape[2:4], default=0) > _LONGEST_SIDE):
            yield (
                f"'/{name}' has the shape {shape}, more than {LARGEST_RECORDING // 10**6} MB a recording or pictures "
                f"of more than {_LONGEST_SIDE} pixels on a side: store shorter recordings of smaller pictures."
            )
            return
    time = file["time"].shape
    if len(time) != 1 or time[0] < 2:
        yield f"'/time' has the shape {time}, but must be [T] with T of at least 2."
        return
    frames = time[0]
    trajectories = recordings_in(file)
    if trajectories < 1:
        yield "the file holds no recording: add some."
        return
    given = file["input"].shape if "input" in file else (trajectories, 0)
    if len(given) not in (2, 3) or (len(given) == 3 and given[1] != frames):
        yield (
            f"'/input' has the shape {given}, but must be [N, l] or [N, T, l] with T = {frames} as in '/time'; "
            "leave it out if nothing drives the motion."
        )
        return
    if "image" in file:
        shape = file["image"].shape
        if len(shape) != 5 or shape[:2] != (trajectories, frames) or shape[-1] != 3 or 0 in shape:
            count = f"N = {trajectories} as in '/input' and " if "input" in file else ""
            yield (
                f"'/image' has the shape {shape}, but must be [N, T, H, W, 3] with {count}T = {frames} as in '/time'."
            )
    for name in ("state", "state_derivative"):
        if name in file and (file[name].ndim != 3 or file[name].shape[:2] != (trajectories, frames)):
            yield f"'/{name}' has the shape {file[name].shape}, but must be [{trajectories}, {frames}, d]."
            return
    derivative = file["state_derivative"].shape if "state_derivative" in file else None
    if derivative is not None and ("state" not in file or file["state"].shape != derivative):
        yield "'/state_derivative' must come with a '/state' of the same shape: remove it or add the state."
    yield from _names_problems(file, given[-1])
    for name, dataset in file.get("parameters", {}).items():
        if dataset.shape[:1] != (trajectories,):
            yield f"'/parameters/{name}' has the shape {dataset.shape}, but must be [{trajectories}, ...]."


def _names_problems(file: File, inputs: int) -> Iterator[str]:
    components = file["state"].shape[-1] if "state" in file else None
    for name, field, count in (
        ("state_names", "state", components),
        ("units", "state", components),
        ("input_names", "input", inputs),
    ):
        if count is not None and name in file.attrs and len(np.atleast_1d(file.attrs[name])) != count:
            yield (
                f"the attribute '{name}' has {len(np.atleast_1d(file.attrs[name]))} entries, but '/{field}' has "
                f"{count} components: give one a component."
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
        yield f"'{name}'[{where}] is {value} ({count} such values): remove the recording or fix the numbers."


def check_images(file: File) -> list[str]:
    """Name the recordings whose pictures cannot be decoded."""
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
