"""Files that are whole or absent."""

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from keycld._errors import KeycldError


def sync(path: Path) -> None:
    """Flush a file or a folder to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def writing_error(path: Path, error: OSError) -> KeycldError:
    """A sentence for an OSError met while writing `path`."""
    if error.errno == errno.ENOSPC or "No space left" in str(error):
        return KeycldError(f"the disk is full while writing {path}: free some space and run the same command again.")
    return KeycldError(f"cannot write {path} ({error.strerror or error}): choose a folder that you may write to.")


@contextlib.contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Give a temporary name beside `path`; on success flush and rename it, on failure remove it.

    **Raises:** `KeycldError` where the folder cannot be written or the disk is full.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        sync(temporary)
        os.replace(temporary, path)
        sync(path.parent)
    except OSError as error:
        raise writing_error(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()
