"""Files that are whole or absent, whatever kills the process."""

import contextlib
import errno
import itertools
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from keycld._errors import KeycldError


@contextlib.contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give a temporary path of the same name; what was written there replaces `path` at the end, safe on the disk.

    Folders are made where they are missing. If the body fails, `path` is left as it was.

    Raises:
        KeycldError: the folder cannot be made or written, or the disk is full.
    """
    path = Path(path)
    # A hidden folder: writers see the name's suffix, and nobody who lists files takes it for one.
    hidden = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        hidden.mkdir(parents=True, exist_ok=True)
        yield hidden / path.name
        sync(hidden / path.name)
        os.replace(hidden / path.name, path)
        sync(path.parent)
    except OSError as error:
        raise writing_error(path, error) from error
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all.

    Raises:
        KeycldError: as `replacing`.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def aside_of(path: Path, mark: str) -> Path:
    """A free name beside `path` for what is there but of another version: NAME.MARK, NAME.MARK.1 and so on."""
    names = (f"{path.name}.{mark or 'unknown'}{'' if n == 0 else f'.{n}'}" for n in itertools.count())
    return next(path.with_name(name) for name in names if not path.with_name(name).exists())


def make_folder(path: Path) -> None:
    """Make a folder and those above it, where they are missing.

    Raises:
        KeycldError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise writing_error(path, error) from error


def sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def writing_error(path: Path, error: OSError) -> KeycldError:
    """What to tell of a file that could not be written."""
    # h5py gives the reason in the text only.
    if error.errno in (errno.ENOSPC, errno.EDQUOT) or "No space left" in str(error):
        return KeycldError(f"the disk is full while writing {path}: free some space and run it again.")
    reason = error.strerror or str(error)
    return KeycldError(f"cannot write {path} ({reason}): choose a folder that you may write to.")
