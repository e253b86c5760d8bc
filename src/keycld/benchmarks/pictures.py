"""Truth and the predictions of all models together: the sheets of the paper's Figs. 4 and 13 to 15, and movies."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, UInt8

from keycld._errors import KeycldError
from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.suites import MODEL_TITLES
from keycld.benchmarks.table import done_results
from keycld.drawing import enlarge, labelled_sheet, overlay_timeline, side_by_side
from keycld.evaluation import Protocol, load_evaluation

TRUTH = "ground truth"


@dataclass(frozen=True)
class Gallery:
    """The first trajectory of a protocol as it was and as each model predicts it.

    Attributes:
        label: the data set.
        index: which frames are stored `[n]`.
        dt: seconds between frames of the recording.
        truth: `[n, H, W, 3]`.
        predictions: by the model's title, each `[n, H, W, 3]`.
        valid: likewise, whether the prediction has stayed below ε up to each stored frame `[n]`.
        seeds: likewise, which seed is shown.
    """

    label: str
    index: np.ndarray
    dt: float
    truth: UInt8[np.ndarray, "n H W 3"]
    predictions: dict[str, UInt8[np.ndarray, "n H W 3"]]
    valid: dict[str, Bool[np.ndarray, "n"]]
    seeds: dict[str, int]


def gallery(experiments: Sequence[Experiment], place: Place, label: str, protocol: Protocol) -> Gallery | None:
    """What the run folders of the done experiments on one data set hold; None where all are gone.

    Each model is shown with the first of its seeds that has a run folder: not chosen by its score.
    """
    predictions, valid, seeds = {}, {}, {}
    known = None
    for experiment, _ in done_results(experiments, place):
        title = MODEL_TITLES[experiment.model]
        if experiment.data.label != label or title in predictions:
            continue
        with contextlib.suppress(KeycldError):  # a run folder may be gone
            stored = load_evaluation(place.run(experiment), protocol.name)
            known = stored.arrays
            predictions[title] = known["prediction"][0]
            valid[title] = stored.valid[0, known["shown_index"]]
            seeds[title] = experiment.seed
    if known is None:
        return None
    index = known["shown_index"]
    dt = float(known["time"][1] - known["time"][0])
    order = [title for title in MODEL_TITLES.values() if title in predictions]
    return Gallery(
        label,
        index,
        dt,
        known["truth"][0],
        {title: predictions[title] for title in order},
        {title: valid[title] for title in order},
        {title: seeds[title] for title in order},
    )


def sheet_of(found: Gallery, every: int = 4, scale: int = 2) -> UInt8[np.ndarray, "H W 3"]:
    """Every fourth frame: the ground truth above, the models below one another (Figs. 4 and 13 to 15)."""
    rows = [found.truth, *found.predictions.values()]
    heads = [str(number) for number in found.index[::every]]
    return labelled_sheet([row[::every] for row in rows], [TRUTH, *found.predictions], heads, scale)


def movie_of(found: Gallery, scale: int = 4) -> UInt8[np.ndarray, "T H W 3"]:
    """Ground truth and all models side by side, each with a bar that turns red when the prediction is not valid."""
    always = np.ones(len(found.truth), bool)
    panels = [(found.truth, always), *((found.predictions[title], found.valid[title]) for title in found.predictions)]
    stacks = [overlay_timeline(enlarge(frames, scale), good, height=2 * scale) for frames, good in panels]
    frames = side_by_side(stacks, [TRUTH, *found.predictions])
    # The last one is held for half a second, so that the eye finds the start again.
    return np.concatenate([frames, np.repeat(frames[-1:], 12, axis=0)])


def frames_per_second(found: Gallery) -> float:
    """Of its movie: real time, but at most 25 pictures a second."""
    return min(25.0, 1.0 / (found.dt * float(found.index[1] - found.index[0])))
