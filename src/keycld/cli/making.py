"""Making of the data of a known system when a verb needs them."""

import os
import sys
from pathlib import Path


def data_for(name: str) -> str:
    """Return a data set's name or folder; the data of a known system are made under `data/` first if missing."""
    from keycld.data import finished
    from keycld.systems import names

    folder = Path("data") / name
    if name in names() and not finished(folder):
        print(f"no complete data for {name} yet: making data/{name}", file=sys.stderr)
        from keycld.cli.data import make

        make(name)
    return name


def name_of(folder: Path) -> str:
    """Return the name of a data set's folder, for the names of what is made of it; `.` and `..` stand for others.

    A link keeps its own name.
    """
    return os.path.basename(os.path.abspath(folder))
