"""Makes the data set of a known system when a verb needs it."""

import sys
from pathlib import Path


def data_for(name: str) -> str:
    """Return the data set for a name or folder; that of a known system is made under `data/` first if it is missing."""
    from keycld.data import unfinished
    from keycld.systems import names

    folder = Path("data") / name
    if name in names() and (unfinished(folder) or not (folder / "train.h5").exists()):
        print(f"no complete data for {name} yet: making data/{name}", file=sys.stderr)
        from keycld.cli.data import make

        make(name)
    return name
