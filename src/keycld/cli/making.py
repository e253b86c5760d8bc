"""Makes the data of a known system where a verb needs them and they are not there."""

import sys
from pathlib import Path


def data_for(name: str) -> str:
    """The data set for a name or folder; a known system's is made under `data/` first if it is missing."""
    from keycld.data import unfinished
    from keycld.systems import names

    folder = Path("data") / name
    if name in names() and (unfinished(folder) or not (folder / "train.h5").exists()):
        print(f"no whole data for {name} yet: making data/{name}", file=sys.stderr)
        from keycld.cli.data import make

        make(name)
    return name
