"""What the statistics of a sampled system's data hold in addition to those of every set."""

from pathlib import Path
from typing import Any

import numpy as np

from keycld.data.describe.normalised_error import trivial_scores
from keycld.data.describe.statistics import PICTURED, first_pictures
from keycld.data.format.derived import known
from keycld.data.format.reading import blocks, read
from keycld.systems import AbstractRenderedSystem, numbers_only


def sampled_figures(folder: Path) -> dict[str, Any]:
    """Compute figures of the training parameters, of the conserved quantity, and of the trivial predictions.

    - `parameters`: `least`, `mean` and `largest` of each over the training set;
    - `conserved`: the same of the conserved quantity in the first frame, and `largest_change` of it along a recording,
      over the first 1,000 training recordings;
    - `baselines`: `trivial_scores` of the first 1,000 recordings of train and test.
    """
    path = folder / "train.h5"
    gathered: dict[str, list[np.ndarray]] = {}
    for block in blocks(path):
        for name, value in numbers_only(block.parameters).items():
            gathered.setdefault(name, []).append(value)
    figures: dict[str, Any] = {"parameters": {name: _range(np.concatenate(v)) for name, v in gathered.items()}}
    train = read(path, images=False, rows=slice(0, PICTURED))
    system = known(train)
    if isinstance(system, AbstractRenderedSystem) and train.state is not None:
        conserved = system.all_conserved(train.state, numbers_only(train.parameters))
        change = np.abs(conserved - conserved[:, :1]).max()
        figures["conserved"] = {**_range(conserved[:, 0]), "largest_change": float(change)}
    return figures | {"baselines": trivial_scores(first_pictures(path), first_pictures(folder / "test.h5"))}


def _range(values: np.ndarray) -> dict[str, float]:
    return {"least": float(values.min()), "mean": float(values.mean()), "largest": float(values.max())}
