"""What the statistics of a sampled system's data hold beside those of every set."""

from pathlib import Path
from typing import Any

import numpy as np

from keycld.data.baselines import trivial_scores
from keycld.data.drawn import known, with_pictures
from keycld.data.statistics import PICTURED
from keycld.data.store import blocks, read
from keycld.systems import AbstractDrawnSystem, numbers_only


def sampled_figures(folder: Path) -> dict[str, Any]:
    """Figures of the training parameters, of what motion conserves, and of the trivial predictions.

    - `parameters`: `least`, `mean` and `largest` of each over the training set;
    - `conserved`: the same of the conserved quantity at the start, and `largest_change` of it along a recording;
    - `baselines`: `trivial_scores` of train and test.
    """
    path = folder / "train.h5"
    gathered: dict[str, list[np.ndarray]] = {}
    for block in blocks(path):
        for name, value in numbers_only(block.parameters).items():
            gathered.setdefault(name, []).append(value)
    train, test = (with_pictures(read(folder / f"{name}.h5", rows=slice(0, PICTURED))) for name in ("train", "test"))
    assert train.image is not None and test.image is not None
    figures: dict[str, Any] = {"parameters": {name: _range(np.concatenate(v)) for name, v in gathered.items()}}
    system = known(train)
    if isinstance(system, AbstractDrawnSystem) and train.state is not None:
        conserved = system.all_conserved(train.state, numbers_only(train.parameters))
        change = np.abs(conserved - conserved[:, :1]).max()
        figures["conserved"] = {**_range(conserved[:, 0]), "largest_change": float(change)}
    return figures | {"baselines": trivial_scores(train.image, test.image)}


def _range(values: np.ndarray) -> dict[str, float]:
    return {"least": float(values.min()), "mean": float(values.mean()), "largest": float(values.max())}
