"""HDF5 files: opened without following what leads out of them, and written as a whole or not at all."""

import contextlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py

from keycld._errors import KeycldError
from keycld._files import replacing

# More than deflate can compress: at most 258 bytes take two bits.
_DEFLATE = 1100


@contextlib.contextmanager
def open_file(path: str | Path) -> Iterator[Any]:
    """Open an HDF5 file for reading.

    Raises:
        KeycldError: there is none, it may not be read, its contents lie in other files, it claims more than it holds,
            or it is truncated or damaged, found now or later while reading.
    """
    path = Path(path)
    if path.is_dir():
        raise KeycldError(f"{path} is a folder: name one of the .h5 files in it.")
    if not path.exists():
        raise KeycldError(f"there is no file {path}: check the path.")
    if not path.is_file():
        raise KeycldError(f"{path} is no regular file: name an .h5 file.")
    try:
        file = h5py.File(path, "r")
    except PermissionError:
        raise KeycldError(f"{path} may not be read: change its permissions.") from None
    except Exception as error:  # on damaged bytes h5py may raise anything, or hand out None
        if path.stat().st_size and not h5py.is_hdf5(path):
            raise KeycldError(
                f"{path} is no HDF5 file: name an .h5 file, or make data of a video with `keycld data import`."
            ) from None
        raise KeycldError(
            f"{path} is not a whole HDF5 file, it is truncated or damaged: copy or make it again ({error})."
        ) from error
    try:
        with file:
            _refuse_outside(file, path)
            yield file
    except (KeycldError, MemoryError):
        raise
    except Exception as error:
        raise KeycldError(
            f"{path} is damaged, or holds something else than data of this format: copy or make it again ({error})."
        ) from error


def _refuse_outside(file: h5py.File, path: Path) -> None:
    """Refuse a file that names other files, or that claims more values than its bytes can hold."""
    size = path.stat().st_size
    for name, item in _items(file, path):
        if not isinstance(item, h5py.Dataset):
            continue
        if item.external or item.is_virtual:
            raise KeycldError(f"'/{name}' of {path} lies in other files, which are not read: store it in the file.")
        if item.dtype.hasobject and h5py.check_string_dtype(item.dtype) is None:
            raise KeycldError(f"'/{name}' of {path} is {item.dtype}: store numbers or texts.")
        claimed, stored = math.prod(item.shape or (0,)) * item.dtype.itemsize, item.id.get_storage_size()
        if stored > size or claimed > _DEFLATE * stored:
            raise KeycldError(
                f"'/{name}' of {path} claims {claimed:,} bytes, which {stored:,} stored ones cannot hold: copy or make "
                "the file again."
            )


def _items(group: Any, path: Path, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the entries of the root and of `/parameters` by name; links are not followed."""
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise KeycldError(f"'/{prefix}{name}' of {path} is a link, which is not followed: store the field itself.")
        yield f"{prefix}{name}", group[name]
        if not prefix and name == "parameters" and isinstance(group[name], h5py.Group):
            yield from _items(group[name], path, "parameters/")


@contextlib.contextmanager
def create_file(path: str | Path) -> Iterator[h5py.File]:
    """Make an HDF5 file, which replaces `path` at the end.

    Raises:
        KeycldError: it cannot be written, or the disk is full.
    """
    with replacing(path) as temporary, open(temporary, "w+b", buffering=0) as raw:
        sink = _Sink(raw)
        try:
            with h5py.File(sink, "w") as file:
                yield file
        except Exception:
            # What HDF5 makes of a failed write says less than the failure itself.
            sink.check()
            raise
        sink.check()


class _Sink:
    """A file for HDF5, which may crash the process where a write fails: the error is kept, and raised at the end."""

    def __init__(self, raw: Any):
        self._raw, self._error = raw, None
        self.seek, self.tell, self.read = raw.seek, raw.tell, raw.read

    def write(self, contents: Any) -> int:
        view = memoryview(contents).cast("B")
        try:
            done = 0
            while self._error is None and done < len(view):
                done += self._raw.write(view[done:])
        except OSError as error:
            self._error = error
        return len(view)

    def readinto(self, buffer: Any) -> int:
        return self._raw.readinto(buffer)

    def truncate(self, size: int) -> int:
        try:
            return self._raw.truncate(size)
        except OSError as error:
            self._error = self._error or error
            return size

    def flush(self) -> None:
        pass

    def check(self) -> None:
        if self._error is not None:
            raise self._error
