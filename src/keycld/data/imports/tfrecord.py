"""TFRecord files of `tf.train.Example`s, read without TensorFlow.

A record is framed by its length and check-sums; an example is a protocol buffer, a map from names to lists of bytes,
floats or integers.
"""

import math
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int64

from keycld._errors import KeycldError
from keycld._files import read_text
from keycld.data.format.rules import LARGEST_RECORDING
from keycld.drawing import load_image

_POLYNOMIAL = 0x82F63B78  # of CRC-32C
_FEATURE = re.compile(r"([\w/]{1,100}), (\((?:\d{1,9}, ?)*(?:\d{1,9})?\)), (u?int(?:8|16|32|64)|float(?:32|64))")
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5


class Feature(NamedTuple):
    """A line of `features.txt`: shape and type of one array of every example."""

    shape: tuple[int, ...]
    dtype: np.dtype


def read_features(path: Path) -> dict[str, Feature]:
    """Read the arrays that `features.txt` declares: lines such as `other/m, (1,), float64`.

    Raises:
        KeycldError: there is no such file, or a line is not of this form.
    """
    try:
        lines = read_text(path).splitlines()
    except FileNotFoundError:
        raise KeycldError(f"there is no {path}: name the folder that holds features.txt.") from None
    features = {}
    for line in filter(None, map(str.strip, lines)):
        match = _FEATURE.fullmatch(line)
        if match is None:
            raise KeycldError(f"{path}: '{line[:60]}' is not of the form 'name, shape, type'.")
        shape, dtype = tuple(int(n) for n in re.findall(r"\d+", match[2])), np.dtype(match[3])
        if math.prod(shape) * dtype.itemsize > LARGEST_RECORDING:
            raise KeycldError(f"{path}: '{line[:60]}' is larger than {LARGEST_RECORDING // 10**6} MB: copy it again.")
        features[match[1]] = Feature(shape, dtype)
    if missing := {"x", "image"} - features.keys():
        raise KeycldError(f"{path} lacks the array '{min(missing)}': copy it again.")
    return features


def read_examples(path: Path, features: dict[str, Feature]) -> Iterator[dict[str, np.ndarray]]:
    """Read the examples of one file, in the encoding of "Which priors matter?".

    uint8 arrays are PNG pictures, stacks of them one below the other; all other types are the array's bits, seen as
    64-bit integers.

    Raises:
        KeycldError: the file is missing, truncated or damaged, or an example lacks an array.
    """
    for number, record in enumerate(_records(path)):
        try:
            found = _example(record)
            yield {name: _array(found[name], feature) for name, feature in features.items()}
        except Exception as error:  # a damaged record may break any step
            raise KeycldError(f"{path}: record {number} is damaged ({error!r}): copy the file again.") from error


def count_records(path: Path) -> int:
    """Count the records of a file.

    Raises:
        KeycldError: the file is missing, truncated or damaged.
    """
    return sum(1 for _ in _records(path, contents=False))


def _array(values: Any, feature: Feature) -> np.ndarray:
    if feature.dtype == np.uint8:
        return load_image(values[0]).reshape(feature.shape)
    return values.view(feature.dtype).reshape(feature.shape)


def _records(path: Path, contents: bool = True) -> Iterator[bytes]:
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise KeycldError(f"{path} is no regular file: copy it again.")
        file = open(path, "rb")  # noqa: SIM115
    except OSError as error:
        raise KeycldError(f"cannot read {path} ({error.strerror}): check the path.") from None
    with file:
        number = 0
        while header := file.read(12):
            if len(header) < 12 or struct.unpack("<I", header[8:])[0] != _masked(_crc32c(header[:8])):
                raise KeycldError(f"{path} is not a whole TFRecord file, record {number} is damaged: copy it again.")
            (length,) = struct.unpack("<Q", header[:8])
            if length > size:
                raise KeycldError(f"{path} is truncated in record {number}: copy it again.")
            # The check-sum of the record itself is not compared: in Python that would take longer than all the rest.
            record = file.read(length) if contents else b""
            if not contents:
                file.seek(length, 1)
            if len(record) < length * contents or len(file.read(4)) < 4:
                raise KeycldError(f"{path} is truncated in record {number}: copy it again.")
            yield record
            number += 1


def _crc32c(data: bytes) -> int:
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ (_POLYNOMIAL if value & 1 else 0)
    return value ^ 0xFFFFFFFF


def _masked(crc: int) -> int:
    return (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF


def _varint(data: memoryview, position: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7
        if shift > 63:
            raise ValueError("an integer of more than 64 bits")


def _message(data: memoryview) -> Iterator[tuple[int, Any]]:
    """Yield field numbers and values of a protocol buffer: integers, or bytes."""
    position = 0
    while position < len(data):
        tag, position = _varint(data, position)
        number, kind = tag >> 3, tag & 7
        if kind == _VARINT:
            value, position = _varint(data, position)
            yield number, value
            continue
        if kind == _BYTES:
            length, position = _varint(data, position)
        elif kind in (_FIXED32, _FIXED64):
            length = 4 if kind == _FIXED32 else 8
        else:
            raise ValueError(f"wire type {kind}")
        if position + length > len(data):
            raise ValueError("a field reaches beyond the end")
        yield number, data[position : position + length]
        position += length


def _example(record: bytes) -> dict[str, Any]:
    found = {}
    for _, features in _message(memoryview(record)):
        for _, entry in _message(features):
            (_, name), (_, feature) = sorted(_message(entry), key=lambda field: field[0])
            for kind, values in _message(feature):
                found[bytes(name).decode()] = _list(kind, values)
    return found


def _list(kind: int, values: memoryview) -> Any:
    """Decode a list of bytes (1) or of integers (3), packed or not."""
    if kind == 1:
        return [bytes(value) for _, value in _message(values)]
    if kind != 3:
        raise ValueError("a list of floats")
    parts = [value for _, value in _message(values)]
    if parts and isinstance(parts[0], int):
        return np.array(parts, np.uint64).view(np.int64)
    return np.concatenate([_packed(part) for part in parts]) if parts else np.empty(0, np.int64)


def _packed(data: memoryview) -> Int64[np.ndarray, "n"]:
    """Decode many varints at once: seven bits a byte, the lowest first, the last byte without its top bit."""
    byte = np.frombuffer(data, np.uint8)
    last = np.flatnonzero(byte < 0x80)
    first = np.concatenate([[0], last[:-1] + 1])
    place = np.arange(len(byte)) - np.repeat(first, last - first + 1)
    bits = (byte & 0x7F).astype(np.uint64) << (7 * place).astype(np.uint64)
    return np.add.reduceat(bits, first).view(np.int64)
