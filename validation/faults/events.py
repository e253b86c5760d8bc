"""Events of `sys.addaudithook` that change files."""

import os
from typing import Any

_CHANGES = ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate", "os.link", "os.symlink",
           "shutil.rmtree", "shutil.copyfile")  # fmt: skip


def changed_path(event: str, arguments: tuple[Any, ...]) -> str | None:
    """Return the path that an event of `sys.addaudithook` changes, or None."""
    writes = event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)
    # Within `shutil.rmtree`, an event of its own, names are relative to an open folder.
    within = event in ("os.remove", "os.rmdir") and arguments[1] != -1
    if within or not (writes or event in _CHANGES) or not isinstance(arguments[0], (str, os.PathLike)):
        return None
    return os.path.realpath(arguments[0])
