"""Contents of JSON and NPZ files, checked against the types that the program expects: one place, one kind of error."""

import dataclasses
import io
import json
import math
import types
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, Required, TypeVar, Union, get_args, get_origin, get_type_hints
from typing import is_typeddict as is_typed_dict

import numpy as np

from keycld._errors import KeycldError
from keycld._files import checked_name, read_bytes, read_text

Name = Annotated[str, checked_name]
"""A text that becomes part of a path."""


def _positive_number(text: str, where: object) -> str:
    try:
        fits = 0.0 < float(text) < math.inf
    except ValueError:
        fits = False
    return _require(fits and len(text) <= 20, text, "a positive number", str(where))


NumberText = Annotated[str, _positive_number]
"""A positive number as text, such as the name of a threshold."""

_LARGEST_NUMBER = 2**53
# More than deflate can compress: at most 258 bytes take two bits.
_DEFLATE = 1100
# Arrays of a result: the errors and the keypoints of 10,000 recordings, and pictures of a few.
_LARGEST_ARRAYS = 2**30
T = TypeVar("T")


class Unexpected(ValueError):
    """A value is not of the expected type; the message says where, what it is and what it must be."""


def checked(value: Any, kind: Any, where: str = "") -> Any:
    """Return a value that JSON or TOML gave, if it is of the type `kind`; a dataclass is made from a table.

    Args:
        value: numbers, texts, lists, tables and None.
        kind: the type: bool, int, float (also a whole number), str, None, Any, `Name`, a `Literal`, a union, list[…],
            tuple[…] (a list stays one), dict[str, …], a `TypedDict` or a dataclass. A table may have entries that a
            `TypedDict` does not name.
        where: the dotted name of the value.

    Raises:
        Unexpected: it is not.
    """
    origin, inner = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin is Annotated:
        return inner[1](checked(value, inner[0], where), where)
    if origin in (NotRequired, Required):
        return checked(value, inner[0], where)
    if origin in (Union, types.UnionType):
        return _one_of(value, inner, where)
    if origin is Literal:
        return _require(value in inner, value, f"one of {', '.join(map(repr, inner))}", where)
    if kind in (None, type(None)):
        return _require(value is None, value, "null", where)
    if kind is bool:
        return _require(isinstance(value, bool), value, "true or false", where)
    if kind is int:
        whole = isinstance(value, int) and not isinstance(value, bool) and abs(value) < _LARGEST_NUMBER
        return _require(whole, value, "a whole number", where)
    if kind is float:
        number = isinstance(value, int | float) and not isinstance(value, bool) and not abs(value) > 1e300
        return float(_require(number, value, "a number", where))
    if kind is str:
        return _require(isinstance(value, str), value, "text", where)
    if origin in (list, tuple):
        return _list(value, origin, inner, where)
    if origin is dict:
        _require(isinstance(value, dict), value, "a table", where)
        return {checked(name, inner[0], where): checked(v, inner[1], _dotted(where, name)) for name, v in value.items()}
    return _table(value, kind, where)


def _one_of(value: Any, kinds: tuple[Any, ...], where: str) -> Any:
    for k, kind in enumerate(kinds):
        try:
            return checked(value, kind, where)
        except Unexpected:
            if k == len(kinds) - 1:
                raise
    raise AssertionError


def _list(value: Any, origin: Any, kinds: tuple[Any, ...], where: str) -> Any:
    _require(isinstance(value, list | tuple), value, "a list", where)
    if origin is tuple and kinds[-1] is not Ellipsis:
        _require(len(value) == len(kinds), value, f"a list of {len(kinds)}", where)
    else:
        kinds = kinds[:1] * len(value)
    return type(value)(
        checked(each, kind, _dotted(where, k)) for k, (each, kind) in enumerate(zip(value, kinds, strict=True))
    )


def _table(value: Any, kind: Any, where: str) -> Any:
    _require(isinstance(value, dict), value, "a table", where)
    hints = get_type_hints(kind, include_extras=True)
    if is_typed_dict(kind):
        required = kind.__required_keys__
    else:
        required = {f.name for f in dataclasses.fields(kind) if f.default is f.default_factory is dataclasses.MISSING}
        if unknown := value.keys() - hints.keys():
            raise Unexpected(f"'{_dotted(where, min(unknown))}' is not known")
    if missing := required - value.keys():
        raise Unexpected(f"'{_dotted(where, min(missing))}' is missing")
    known = {name: checked(v, hints[name], _dotted(where, name)) for name, v in value.items() if name in hints}
    return {**value, **known} if is_typed_dict(kind) else kind(**known)


def _require(fits: bool, value: Any, what: str, where: str) -> Any:
    if not fits:
        text = repr(value)
        shown = text if len(text) <= 60 else text[:57] + "…"
        raise Unexpected(f"'{where}' is {shown}, but must be {what}" if where else f"it is {shown}, not {what}")
    return value


def _dotted(where: str, name: Any) -> str:
    return f"{where}.{name}" if where else str(name)


def read_json(path: Path, kind: type[T] | Any, fix: str) -> Any:
    """Read a JSON file, and check it.

    Args:
        path: the file.
        kind: the type of its value, as for `checked`.
        fix: what to do if it is damaged.

    Raises:
        FileNotFoundError: there is none.
        KeycldError: it is damaged or holds something else; or as `read_bytes`.
    """
    # Not below: a file that may not be read is not damaged, and must not be deleted.
    contents = read_bytes(path)
    try:
        return checked(json.loads(contents), kind)
    except (ValueError, RecursionError) as error:
        raise damaged(path, error, fix) from error


def damaged(path: Path, error: Exception | str, fix: str) -> KeycldError:
    """Return the error for a file whose contents are not what they must be."""
    return KeycldError(f"{path} is damaged ({str(error).strip('. ')}): {fix}.")


def read_lines(path: Path, kind: type[T] | Any) -> list[Any]:
    """Read a file with one JSON value on each line; lines that a killed process left incomplete are left out.

    Raises:
        KeycldError: it is no text or may not be read.
    """
    found = []
    try:
        lines = read_text(path).splitlines()
    except FileNotFoundError:
        return []
    for line in lines:
        try:
            found.append(checked(json.loads(line), kind))
        except (ValueError, RecursionError):
            continue
    return found


def read_arrays(path: Path, layout: Mapping[str, tuple[str, str]], fix: str) -> dict[str, np.ndarray]:
    """Read the arrays of an NPZ file by name; no code in the file is run, and no claimed size is believed.

    Args:
        path: the file.
        layout: kinds of the data type (as in `numpy.dtype.kind`) and dimensions of arrays by name; a dimension is a
            number, or a word that means the same number in all arrays. Others may have any. No array need be there.
        fix: what to do if the file is damaged.

    Raises:
        FileNotFoundError: there is none.
        KeycldError: it is damaged, too large, or an array is not as in `layout`.
    """
    contents = read_bytes(path, _LARGEST_ARRAYS)
    try:
        with zipfile.ZipFile(io.BytesIO(contents)) as archive:
            entries = archive.infolist()
            size = sum(entry.file_size for entry in entries)
            if size > min(_LARGEST_ARRAYS, _DEFLATE * len(contents)):
                raise Unexpected(f"its arrays claim {size:,} bytes")
            found = {entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries}
    except Exception as error:  # the library raises anything on damaged bytes
        raise damaged(path, error, fix) from error
    sizes: dict[str, int] = {}
    for name in layout.keys() & found.keys():
        kinds, dimensions = layout[name][0], layout[name][1].split()
        shape = found[name].shape
        # An array of three dots stands for any number of dimensions.
        words = (
            dimensions[:-1] + ["_"] * (len(shape) - len(dimensions) + 1) if dimensions[-1:] == ["..."] else dimensions
        )
        fits = len(shape) == len(words) and found[name].dtype.kind in kinds
        if not fits or any(n != _size(word, n, sizes) for word, n in zip(words, shape, strict=True)):
            where = f"its array '{name}' is {found[name].dtype}{list(shape)}, not as the others and the scores say"
            raise damaged(path, where, fix)
    return found


def _size(word: str, n: int, sizes: dict[str, int]) -> int:
    return n if word == "_" else int(word) if word.isdigit() else sizes.setdefault(word, n)


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        shape, fortran, dtype = read_header[version](file)
        if dtype.hasobject or math.prod(shape) * dtype.itemsize != entry.file_size - file.tell():
            raise Unexpected(f"'{entry.filename}' claims {dtype}{list(shape)}")
        values = np.frombuffer(bytearray(file.read()), dtype)
    return values.reshape(shape, order="F" if fortran else "C")
