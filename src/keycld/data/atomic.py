"""Files that are whole or absent."""

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from keycld._errors import KeycldError


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _writing_error(path: Path, error: OSError) -> KeycldError:
    # h5py gives the reason in the text only.
    if error.errno in (errno.ENOSPC, errno.EDQUOT) or "No space left" in str(error):
        return KeycldError(f"the disk is full while writing {path}: free some space and run it again.")
    reason = error.strerror or str(error)
    return KeycldError(f"cannot write {path} ({reason}): choose a folder that you may write to.")


def make_folder(path: Path) -> None:
    """Make a folder and those above it, where they are missing.

    Raises:
        KeycldError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _writing_error(path, error) from error


@contextlib.contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Give a temporary name beside `path`; on success flush and rename it, on failure remove it.

    Raises:
        KeycldError: the folder cannot be written, or the disk is full.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        yield temporary
        _sync(temporary)
        os.replace(temporary, path)
        _sync(path.parent)
    except OSError as error:
        raise _writing_error(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all.

    Raises:
        KeycldError: as `atomic`.
    """
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
