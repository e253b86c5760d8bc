"""A word about runs whose training has not ended."""

import sys
from pathlib import Path


def say_if_unfinished(run: str | Path, doing: str) -> None:
    """Say that the newest checkpoint of a run is not its last one; nothing of a trained model of the package.

    Args:
        run: run folder, or the name of such a model.
        doing: what is done with the checkpoint.
    """
    from keycld.training import finished

    if (Path(run) / "config.json").exists() and not finished(run):
        print(f"the training of {run} is not finished; {doing} its newest checkpoint", file=sys.stderr)
