"""Truth and the predictions of all models together: sheets like the paper's Figs. 4 and 13 to 15, and movies."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, UInt8

from keycld._errors import KeycldError
from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.suites import model_order, model_title
from keycld.benchmarks.table import done_results
from keycld.drawing import enlarge, labelled_sheet, overlay_timeline, side_by_side
from keycld.evaluation import Protocol, load_evaluation

TRUTH = "ground truth"


@dataclass(frozen=True)
class Gallery:
    """The first trajectory of a protocol: ground truth and each model's prediction.

    Attributes:
        label: the data set.
        index: which frames are stored `[n]`.
        dt: seconds between frames of the recording.
        truth: `[n, H, W, 3]`.
        predictions: by the model's title, each `[n, H, W, 3]`.
        valid: by the model's title, whether the prediction is still valid at each stored frame `[n]`.
        seeds: by the model's title, the seed that is shown.
    """

    label: str
    index: np.ndarray
    dt: float
    truth: UInt8[np.ndarray, "n H W 3"]
    predictions: dict[str, UInt8[np.ndarray, "n H W 3"]]
    valid: dict[str, Bool[np.ndarray, "n"]]
    seeds: dict[str, int]


def gallery(experiments: Sequence[Experiment], place: Place, label: str, protocol: Protocol) -> Gallery | None:
    """Read the predictions of one data set from the run folders of the done experiments; None where all are gone.

    Each model is shown with the first of its seeds that has a run folder: not chosen by its score.
    """
    predictions, valid, seeds = {}, {}, {}
    trained = {experiment.model for experiment in experiments}
    known = None
    for experiment, _ in done_results(experiments, place):
        title = model_title(experiment.model)
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
    order = [model_title(name) for name in model_order(trained) if model_title(name) in predictions]
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
    """Lay out every fourth frame: the ground truth above, one model a row below (Figs. 4 and 13 to 15)."""
    rows = [found.truth, *found.predictions.values()]
    heads = [str(number) for number in found.index[::every]]
    return labelled_sheet([row[::every] for row in rows], [TRUTH, *found.predictions], heads, scale)


def movie_of(found: Gallery, scale: int = 4) -> UInt8[np.ndarray, "T H W 3"]:
    """Put ground truth and all models side by side, each with a bar that is red where the prediction is not valid."""
    always = np.ones(len(found.truth), bool)
    panels = [(found.truth, always), *((found.predictions[title], found.valid[title]) for title in found.predictions)]
    stacks = [overlay_timeline(enlarge(frames, scale), good, height=2 * scale) for frames, good in panels]
    frames = side_by_side(stacks, [TRUTH, *found.predictions])
    # The last frame is repeated for half a second, so the viewer sees where the loop restarts.
    return np.concatenate([frames, np.repeat(frames[-1:], 12, axis=0)])


def frames_per_second(found: Gallery) -> float:
    """Return the frame rate of its movie: real time, but at most 25 frames a second."""
    return min(25.0, 1.0 / (found.dt * float(found.index[1] - found.index[0])))
