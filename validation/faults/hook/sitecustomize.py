"""Copies a folder before each event that changes files in it; Python imports this when a process starts."""

import os
import shutil
import sys
import time
from pathlib import Path
from typing import Any

from validation.faults.events import changed_path

_WORK, _COPIES = Path(os.environ["FAULTS_WORK"]), Path(os.environ["FAULTS_COPIES"])
_copying = False


def _copy(event: str, arguments: tuple[Any, ...]) -> None:
    """Copy the folder if the event changes a file."""
    global _copying
    path = None if _copying else changed_path(event, arguments)
    if path is not None and Path(path).is_relative_to(_WORK):
        _copying = True
        shutil.copytree(_WORK, _COPIES / f"{time.time_ns():020d}", symlinks=True)
        _copying = False


sys.addaudithook(_copy)
