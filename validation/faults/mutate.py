"""Damaged copies of files: each is a function of its seed alone."""

import io
import json
import zipfile
from pathlib import Path
from random import Random
from typing import Any

import h5py
import numpy as np

MARK = "<script>alert(1)</script>"
TEXTS = ["", MARK, "../../escaped", "/etc/passwd", "\x1b[31m", "a" * 5000, ".", "é\u202e", "%s%n", "nan"]
NUMBERS = [0, -1, 1, 2**31, 2**63, 10**30, -0.5, 1e-320, 1e308, float("nan"), float("inf"), True]
OTHERS: list[Any] = [None, [], {}, [[]], {"a": 1}, [1, "a", None], *TEXTS, *NUMBERS]


def damage(path: Path, seed: int) -> str:
    """Damage a file in place, by its structure or by its bytes, and return what was done."""
    random = Random(f"{path.name} {seed}")
    kind = path.suffix
    if random.random() < 0.35 or kind not in (".json", ".jsonl", ".toml", ".csv", ".npz", ".h5"):
        return damage_bytes(path, random)
    if kind in (".json", ".jsonl"):
        return damage_json(path, random)
    if kind in (".toml", ".csv"):
        return damage_text(path, random, "," if kind == ".csv" else " ")
    return damage_npz(path, random) if kind == ".npz" else damage_hdf5(path, random)


def damage_bytes(path: Path, random: Random) -> str:
    """Cut, flip, repeat or replace bytes, or put something else than a file in the place."""
    data = bytearray(path.read_bytes())
    what = random.choice(["cut", "flip", "head", "repeat", "insert", "zeros", "empty", "folder", "random"])
    at = random.randrange(max(1, len(data)))
    if what == "cut":
        del data[at:]
    elif what in ("flip", "head"):
        for _ in range(random.choice([1, 4, 64])):
            if data:
                data[random.randrange(min(len(data), 600) if what == "head" else len(data))] = random.randrange(256)
    elif what == "repeat":
        data[at:at] = data[at : at + 1000] * random.choice([1, 50])
    elif what == "insert":
        data[at:at] = random.randbytes(random.choice([1, 8, 300]))
    elif what == "zeros":
        data[at : at + 200] = bytes(len(data[at : at + 200]))
    elif what == "empty":
        data.clear()
    elif what == "random":
        data[:] = random.randbytes(random.choice([10, 3000]))
    path.unlink()
    if what == "folder":
        path.mkdir()
    else:
        path.write_bytes(data)
    return f"{what} at {at}"


def damage_json(path: Path, random: Random) -> str:
    """Replace, remove, add or nest a value of a JSON file, or of a line of one."""
    lines = path.read_text().splitlines() if path.suffix == ".jsonl" else [path.read_text()]
    chosen = random.randrange(len(lines))
    value = json.loads(lines[chosen])
    places = list(_places(value))
    holder, key = random.choice(places)
    what = random.choice(["replace", "replace", "replace", "remove", "nest", "rename", "deep"])
    if what == "replace":
        holder[key] = random.choice(OTHERS)
    elif what == "remove":
        del holder[key]
    elif what == "nest":
        holder[key] = [holder[key]]
    elif what == "rename" and isinstance(holder, dict):
        holder[random.choice(TEXTS)] = holder.pop(key)
    elif what == "deep":
        holder[key] = "DEEP"
    text = json.dumps(value).replace('"DEEP"', "[" * 100_000 if random.random() < 0.5 else "[" * 50 + "]" * 50)
    lines[chosen] = text
    path.write_text("\n".join(lines) + "\n")
    return f"{what} {key}"


def _places(value: Any):
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in list(items)[:40]:
        yield value, key
        yield from _places(inner)


def damage_text(path: Path, random: Random, between: str) -> str:
    """Replace a word of a text."""
    words = path.read_text().split(between)
    at = random.randrange(len(words))
    words[at] = json.dumps(random.choice(OTHERS), default=str)
    path.write_text(between.join(words))
    return f"word {at}"


def damage_npz(path: Path, random: Random) -> str:
    """Replace an array of an NPZ file, remove it, rename it, or let it claim another shape."""
    with np.load(path) as archive:
        arrays = dict(archive)
    name = random.choice(sorted(arrays))
    what = random.choice(["remove", "shape", "type", "values", "empty", "name", "claim", "texts"])
    value = arrays[name]
    if what == "remove":
        del arrays[name]
    elif what == "shape":
        arrays[name] = value[None] if random.random() < 0.5 else value.reshape(-1)
    elif what == "type":
        kind = random.choice(["float64", "uint8", "int64", "U5", "complex64", "bool"])
        with np.errstate(all="ignore"):
            arrays[name] = value.astype(kind) if value.dtype.kind != "U" else np.zeros(value.shape, kind)
    elif what == "values" and value.dtype.kind == "f":
        arrays[name] = np.full_like(value, random.choice([np.nan, np.inf, -1e30, 0.0]))
    elif what == "values" and value.dtype.kind in "iu":
        arrays[name] = np.full_like(value, random.choice([0, 255, 1]))
    elif what == "empty":
        arrays[name] = value[:0] if value.ndim else np.zeros(0)
    elif what == "name":
        arrays[random.choice(["x/../../../escaped", "a", "names"])] = arrays.pop(name)
    elif what == "texts" and value.dtype.kind == "U":
        arrays[name] = np.array([random.choice(TEXTS[1:]) for _ in range(value.size)])
    with io.BytesIO() as buffer:
        np.savez_compressed(buffer, allow_pickle=False, **arrays)
        contents = buffer.getvalue()
    if what == "claim":
        contents = _claimed(contents, random)
    path.write_bytes(contents)
    return f"{what} {name}"


def _claimed(contents: bytes, random: Random) -> bytes:
    with zipfile.ZipFile(io.BytesIO(contents)) as old, io.BytesIO() as buffer:
        names = old.namelist()
        chosen = random.choice(names)
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as new:
            for name in names:
                data = old.read(name)
                if name == chosen:
                    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 8), }"
                    data = b"\x93NUMPY\x01\x00" + len(header.ljust(117) + b"\n").to_bytes(2, "little")
                    data += header.ljust(117) + b"\n"
                new.writestr(name, data)
        return buffer.getvalue()


def damage_hdf5(path: Path, random: Random) -> str:
    """Replace a field or an attribute of an HDF5 file, with links, other types and sizes that it does not hold."""
    with h5py.File(path, "r+") as opened:
        file: Any = opened
        fields = [name for name in ("image", "input", "time", "state", "state_derivative") if name in file]
        fields += [f"parameters/{name}" for name in file.get("parameters", {})]
        name = random.choice(fields)
        what = random.choice(
            ["remove", "external", "link", "virtual", "soft", "huge", "type", "group", "shape", "values", "attribute"]
        )
        old = file[name][...]
        if what == "attribute":
            key = random.choice(["dt", "system", "schema_version", "state_names", "units", "input_names", "renderer"])
            file.attrs.pop(key, None)
            value = random.choice([*TEXTS[1:], *NUMBERS, [1.0, 2.0], ["a", "b"]])
            if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= 2**63:
                value = float(value)
            file.attrs[key] = value
            return f"attribute {key}"
        del file[name]
        shape = old.shape
        if what == "external":
            file.create_dataset(name, (min(16, max(1, old.size)),), "u1", external=[("/etc/passwd", 0, 16)])
        elif what == "link":
            file[name] = h5py.ExternalLink("/etc/passwd" if random.random() < 0.5 else "other.h5", "/image")
        elif what == "soft":
            file[name] = h5py.SoftLink("/" + name)
        elif what == "virtual":
            layout = h5py.VirtualLayout(shape=(4,), dtype="u1")
            layout[:] = h5py.VirtualSource("other.h5", "image", shape=(4,))
            file.create_virtual_dataset(name, layout)
        elif what == "huge":
            big = random.choice([(10**9, *shape[1:]), (*shape[:-1], 10**9), (1, 2, 8192, 8192, 3), (2**40,)])
            chunks = tuple(min(n, 16) for n in big) if random.random() < 0.5 and 0 not in big else None
            file.create_dataset(name, big, "u1" if name == "image" else "f8", chunks=chunks)
        elif what == "type":
            kind = random.choice(["f4", "i8", "S3", "c16", "b1", "u2"])
            file.create_dataset(name, shape, kind)
        elif what == "group":
            file.create_group(name)
        elif what == "shape":
            file[name] = random.choice([old.reshape(-1), old[None], old[:0], old[..., :0], old[:1]])
        elif what == "values":
            new = np.full_like(old, random.choice([np.nan, 1e308])) if old.dtype.kind == "f" else old
            file[name] = new
        return f"{what} {name}"
