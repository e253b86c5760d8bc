"""Writing of files that are complete or absent, even if the process is killed."""

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
    """Yield a temporary path of the same name, whose file replaces `path` at the end and is then on the disk.

    Missing folders are made. If the body fails, `path` is unchanged.

    Raises:
        KeycldError: the folder cannot be made or written, or the disk is full.
    """
    path = Path(path)
    # In a hidden folder the file keeps its name and suffix, and listings of the outer folder do not show it.
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
    """Write a text file, completely or not at all.

    Raises:
        KeycldError: as `replacing`.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def aside_of(path: Path, mark: str) -> Path:
    """Return a free path next to `path` to rename an old version to: NAME.MARK, NAME.MARK.1 and so on."""
    names = (f"{path.name}.{mark or 'unknown'}{'' if n == 0 else f'.{n}'}" for n in itertools.count())
    return next(path.with_name(name) for name in names if not path.with_name(name).exists())


def make_folder(path: Path) -> None:
    """Make a folder and those above it, if they are missing.

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
    """Return the error for a file that could not be written."""
    # h5py gives the reason in the text only.
    if error.errno in (errno.ENOSPC, errno.EDQUOT) or "No space left" in str(error):
        return KeycldError(f"the disk is full while writing {path}: free some space and run it again.")
    reason = error.strerror or str(error)
    return KeycldError(f"cannot write {path} ({reason}): choose a folder that you may write to.")
