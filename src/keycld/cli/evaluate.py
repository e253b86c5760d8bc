"""The verb `keycld eval`."""

import sys
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

import tyro

from keycld._errors import KeycldError

if TYPE_CHECKING:
    from keycld.data import DataSet
    from keycld.evaluation import Protocol
    from keycld.models.base import AbstractModel


def evaluate(
    run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")],
    /,
    *,
    data: str | None = None,
    protocols: tuple[str, ...] = (),
    given: int | None = None,
    symetric: bool = False,
    json: bool = False,
) -> None:
    """Score a trained run: VPT, error over time, true-state error, energies, next to the trivial baselines.

    Args:
        run: Run folder, or a trained model of the package: pendulum, cartpole, acrobot.
        data: Data set to score on; by default the one of the training. Results on another one get its name as a suffix,
            such as test@50-mine.
        protocols: Such as test@50, validation@50, test_long@200 or test@256-priors, with a suffix -given-N, -from-K
            (recordings from frame K on) or -backward, such as test_long@50-from-30. By default all standard ones of
            the data; test_long.h5 is made if it is needed.
        given: Number of given frames, in place of the protocols' own; more frames make a better initial state.
        symetric: Score how canonical the map from the model's states to the true ones is, in place of all protocols:
            SyMetric, which needs scikit-learn.
        json: Print all scores as JSON, by protocol, instead of tables.
    """
    from keycld.cli.making import data_for
    from keycld.cli.unfinished import say_if_unfinished
    from keycld.data import is_clip, open_data
    from keycld.evaluation import (
        MOTION,
        as_json,
        evaluate_motion,
        evaluate_sweeps,
        references,
        save_evaluation,
        summary,
        with_given,
    )
    from keycld.evaluation import evaluate as score
    from keycld.models.base import HasLagrangian
    from keycld.training import Counted, data_folder, load_run, pretrained, run_folder

    folder, asked = run_folder(run), data
    model, config = load_run(folder)
    say_if_unfinished(folder, "scoring")
    if data is None:
        data = str(data_folder(folder, config.data))
        if not Path(data).is_dir():
            # Data for a packaged model can be made here; a run needs the data that it was trained on.
            if run not in pretrained():
                raise KeycldError(f"the data of {folder}, {data}, are missing: name a data set with --data.")
            data = str(data_for(config.system))
    # Before the long test is made.
    if given is not None and given < model.context:
        raise KeycldError(f"--given is at least {model.context}, the frames that this model needs, not {given}.")
    dataset = open_data(data)
    if symetric:
        _score_symetric(model, dataset, folder, json)
        return
    chosen = _chosen(dataset, model, protocols)
    if given is not None:
        chosen = [with_given(protocol, given) for protocol in chosen]
    shared = references(dataset)
    own = asked in (None, config.data) or _holds(dataset, config.data_hash)
    suffix = "" if own else f"-{dataset.folder.resolve().name}"
    scores = {}
    for protocol in chosen:
        result = score(model, dataset, protocol, shared=shared, progress=Counted(protocol.name))
        save_evaluation(folder, protocol.name + suffix, result)
        scores[protocol.name + suffix] = result.scores
        if not json:
            print(summary(result.scores), flush=True)
    if own and "sweeps" in dataset.splits:
        save_evaluation(folder, "sweeps", evaluate_sweeps(model, dataset))
    # A motion with error bars is one of `keycld watch`, which knows the measured constants.
    if own and is_clip(dataset.attributes) and isinstance(model, HasLagrangian) and not _has_error_bars(folder):
        save_evaluation(folder, MOTION, evaluate_motion(model, dataset))
    print(as_json(scores) if json else f"stored: {folder / 'evaluation'}\nnext: keycld report {quote(str(folder))}")


def _has_error_bars(folder: Path) -> bool:
    from keycld.evaluation import MOTION, load_evaluation

    try:
        return "noise" in load_evaluation(folder, MOTION).scores
    except KeycldError:
        return False


def _score_symetric(model: "AbstractModel", dataset: "DataSet", folder: Path, as_text: bool) -> None:
    """Print and store SyMetric of batches of test trajectories, and their means."""
    import json

    from keycld._files import write_text
    from keycld.evaluation import score_symetric

    found = score_symetric(model, dataset)
    means = {name: sum(getattr(each, name) for each in found) / len(found) for name in found[0]._fields}
    text = json.dumps({"mean": means, "batches": [each._asdict() for each in found]}, indent=1)
    write_text(folder / "symetric.json", text + "\n")
    line = "  ".join(f"{name} {value:.4g}" for name, value in means.items())
    print(text if as_text else f"SyMetric, mean of {len(found)} batches of 5 test trajectories: {line}")


def _chosen(dataset: "DataSet", model: "AbstractModel", names: tuple[str, ...]) -> "list[Protocol]":
    """Return those of the named or standard protocols that the model can be scored under."""
    from keycld.evaluation import protocol_named, protocols_for
    from keycld.models.base import Reversible

    reversible = isinstance(model, Reversible)
    if not reversible:
        print("this model cannot run backward: it is scored forward only", file=sys.stderr)
    named = [protocol_named(name) for name in names]
    chosen = [each for each in named or protocols_for(dataset, model) if reversible or not each.backward]
    if not chosen:
        found = ", ".join(dataset.splits)
        raise KeycldError(f"no protocol fits this model and {dataset.folder} (files: {found}): name others.")
    return chosen


def _holds(dataset: "DataSet", training: str | None) -> bool:
    """Return whether a data set has the training file with this checksum."""
    from keycld.data import sha256

    return "train" in dataset.splits and sha256(dataset.path("train")) == training
