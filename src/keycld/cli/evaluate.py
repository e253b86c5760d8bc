"""`keycld eval`."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from keycld._errors import KeycldError

if TYPE_CHECKING:
    from keycld.data import DataSet


def evaluate(
    run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")],
    /,
    *,
    data: str | None = None,
    protocols: tuple[str, ...] = (),
) -> None:
    """Score a trained run: VPT, error over time, true-state error, energies, and the trivial baselines beside them.

    Args:
        run: Run folder, or a trained model of the package: pendulum, cartpole, acrobot.
        data: Data set to score on; the one it was trained on unless told. Results on another one have its name in
            theirs, such as test@50-mine.
        protocols: Such as test@50, validation@50, test_long@200, test_long@500, or test@50-given-3; all that the data
            has files for unless told.
    """
    from keycld.cli.making import data_for
    from keycld.data import open_data
    from keycld.evaluation import evaluate as score
    from keycld.evaluation import evaluate_sweeps, protocol_named, protocols_for, references, save_evaluation, summary
    from keycld.training import Counted, finished, load_run, pretrained, run_folder

    folder, asked = run_folder(run), data
    model, config = load_run(folder)
    if not finished(folder):
        print(f"{folder} has not trained to its end; scoring its newest checkpoint", file=sys.stderr)
    if data is None:
        data = config.data
        if not Path(data).is_dir():
            # A model of the package may come to a machine that has no data yet; a run's data must be its own.
            if run not in pretrained():
                raise KeycldError(f"{data}, which {folder} was trained on, is not there: name a data set with --data.")
            data = str(data_for(config.system))
    dataset = open_data(data)
    chosen = [protocol_named(name) for name in protocols] or protocols_for(dataset, model.context)
    if not chosen:
        raise KeycldError(f"{dataset.folder} has no file that a protocol scores (test.h5, validation.h5, …).")
    shared = references(dataset)
    own = asked in (None, config.data) or _holds(dataset, config.data_hash)
    suffix = "" if own else f"-{dataset.folder.resolve().name}"
    for protocol in chosen:
        result = score(model, dataset, protocol, shared=shared, progress=Counted(protocol.name))
        save_evaluation(folder, protocol.name + suffix, result)
        print(summary(result.scores), flush=True)
    if own and "sweeps" in dataset.splits:
        save_evaluation(folder, "sweeps", evaluate_sweeps(model, dataset))
    print(f"stored: {folder / 'evaluation'}\nnext: keycld report {folder}")


def _holds(dataset: "DataSet", training: str | None) -> bool:
    """Whether a data set has the training file of that checksum."""
    from keycld.data import sha256

    return "train" in dataset.splits and sha256(dataset.path("train")) == training
