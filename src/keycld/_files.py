"""Files that are complete or absent, even if the process is killed; names and sizes that a file may claim."""

import contextlib
import errno
import itertools
import os
import re
import shutil
import socket
import stat
from collections.abc import Iterator
from pathlib import Path

from keycld._errors import KeycldError

LARGEST_TEXT = 256 * 2**20
"""The most bytes that a file of text or JSON may have: the scores of 10,000 recordings take 20 MB."""

_NAME = re.compile(r"[\w+=@-][\w .,+=@-]{0,99}")
# Temporary folders of this process.
_open: set[Path] = set()


@contextlib.contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path of the same name; the file or folder there replaces `path` at the end, on the disk.

    Missing folders are made. If the body fails, `path` is unchanged. What killed processes left of the same name is
    removed.

    Raises:
        KeycldError: `path` is a folder or a device, the folder cannot be made or written, or the disk is full.
    """
    path = Path(path)
    with hidden_folder(path) as hidden:
        yield hidden / path.name
        sync(hidden / path.name)
        os.replace(hidden / path.name, path)
        sync(path.parent)


@contextlib.contextmanager
def replacing_both(path: Path, other: Path) -> Iterator[tuple[Path, Path]]:
    """Yield temporary paths of two files of one folder that belong together; as `replacing`, for both or for none.

    `path` goes first and appears last: who sees it sees both, of one writer. A process that is killed between these
    steps leaves neither.

    Raises:
        KeycldError: as `replacing`.
    """
    _refuse_special(other)
    with hidden_folder(path) as hidden:
        yield hidden / path.name, hidden / other.name
        for each in (path, other):
            sync(hidden / each.name)
        old = hidden / "old"
        old.mkdir()
        moves = [(each, old / each.name) for each in (path, other) if each.exists()]
        moves += [(hidden / each.name, each) for each in (other, path)]
        done: list[tuple[Path, Path]] = []
        try:
            for source, target in moves:
                os.replace(source, target)
                done.append((source, target))
        except OSError:
            # A quota may refuse even a new name. What these steps have taken of it is free after a commit.
            os.sync()
            for source, target in reversed(done):
                os.replace(target, source)
            raise
        sync(path.parent)


@contextlib.contextmanager
def hidden_folder(path: Path) -> Iterator[Path]:
    """Yield a new hidden folder, which goes at the end, next to the file that is to be written.

    Those of killed processes for the same file are removed.

    Raises:
        KeycldError: as `replacing`, also for an error of the body.
    """
    _refuse_special(path)
    # In a hidden folder the file keeps its name and suffix, and listings of the outer folder do not show it.
    hidden = path.with_name(f".{path.name}.{os.getpid()}@{socket.gethostname()}.partial")
    _open.add(hidden)
    try:
        hidden.mkdir(parents=True, exist_ok=True)
        remove_orphans(path.parent, path.name)
        yield hidden
    except OSError as error:
        raise writing_error(path, error) from error
    finally:
        shutil.rmtree(hidden, ignore_errors=True)
        _open.discard(hidden)


def _refuse_special(path: Path) -> None:
    if path.exists() and not path.is_file():
        kind = "a folder" if path.is_dir() else "no regular file"
        raise KeycldError(f"{path} is {kind}, and stays as it is: choose another name to write to.")


def discard_partial() -> None:
    """Remove the temporary files of this process, which is about to end."""
    for hidden in tuple(_open):
        shutil.rmtree(hidden, ignore_errors=True)


def remove_orphans(folder: Path, name: str | None = None) -> None:
    """Remove what processes of this machine that are dead left in a folder, of all files or of one."""
    names = ".+" if name is None else re.escape(name)
    form = re.compile(rf"\.{names}\.(\d+)(?:@{re.escape(socket.gethostname())})?\.partial")
    with os.scandir(folder) as entries:
        found = [(entry.path, form.fullmatch(entry.name)) for entry in entries]
    for orphan, match in found:
        if match and not alive(int(match[1])):
            shutil.rmtree(orphan, ignore_errors=True)


def alive(pid: int) -> bool:
    """Tell whether this machine has a process of that number."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    # Linux answers for the number of a thread as well, but lists processes alone.
    processes = Path("/proc")
    return not (processes / "self").exists() or str(pid) in os.listdir(processes)


def write_text(path: Path, text: str) -> None:
    """Write a text file, completely or not at all.

    Raises:
        KeycldError: as `replacing`.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def copy_file(source: Path, path: Path) -> None:
    """Copy the contents of a file, completely or not at all.

    Raises:
        KeycldError: as `replacing`.
    """
    with replacing(path) as temporary:
        shutil.copyfile(source, temporary)


def read_bytes(path: Path, most: int = LARGEST_TEXT) -> bytes:
    """Read a whole file, unless it is a device or a pipe, which may have no end.

    Raises:
        FileNotFoundError: there is none.
        KeycldError: it is no regular file, is larger than `most`, or may not be read.
    """
    try:
        # A pipe without a writer would block here.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        with open(handle, "rb") as file:
            found = os.fstat(handle)
            if not stat.S_ISREG(found.st_mode):
                raise KeycldError(f"{path} is no regular file: name one.")
            if found.st_size > most:
                raise KeycldError(f"{path} has {found.st_size:,} bytes, but at most {most:,} are read: check the path.")
            return file.read(most)
    except (FileNotFoundError, NotADirectoryError):
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path)) from None
    except OSError as error:
        raise reading_error(path, error) from error


def read_text(path: Path) -> str:
    """Read a file as UTF-8 text, without the mark at its beginning that some editors write.

    Raises:
        FileNotFoundError: there is none.
        KeycldError: as `read_bytes`, or it is no text.
    """
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise KeycldError(f"{path} is not UTF-8 text ({error.reason}): check the path, or restore the file.") from None


def checked_name(name: object, source: object) -> str:
    """Return a name that a file gives and that becomes part of a path: it must not lead to another folder.

    Args:
        name: what the file says.
        source: the file, for the message.

    Raises:
        KeycldError: it is no text, is empty or too long, begins with a dot, or holds anything that a path gives a
            meaning to.
    """
    if isinstance(name, str) and _NAME.fullmatch(name):
        return name
    raise KeycldError(
        f"{source} holds the name {str(name)[:60]!r}, but a name has 1 to 100 letters, digits, spaces and _-+=@., and "
        "does not begin with a dot: correct it, or make the file again."
    )


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
    # Libraries give the reason in the text only.
    if error.errno in (errno.ENOSPC, errno.EDQUOT) or re.search("No space left|quota exceeded", str(error)):
        return KeycldError(f"the disk is full while writing {path}: free some space and run it again.")
    if error.errno == errno.EFBIG or "File too large" in str(error):
        return KeycldError(f"{path} is larger than this account may write (ulimit -f): raise the limit.")
    reason = error.strerror or str(error)
    return KeycldError(f"cannot write {path} ({reason}): choose a folder that you may write to.")


def reading_error(path: Path, error: OSError) -> KeycldError:
    """Return the error for a file that could not be read."""
    return KeycldError(f"cannot read {path} ({error.strerror or error}): check the path and its permissions.")
