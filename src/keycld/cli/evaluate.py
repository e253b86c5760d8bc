"""`keycld eval`."""

import sys
from pathlib import Path

import tyro

from keycld import KeycldError


def evaluate(
    run: tyro.conf.Positional[str],
    /,
    *,
    data: str | None = None,
    protocols: tuple[str, ...] = (),
) -> None:
    """Score a trained run: VPT, error over time, true-state error, energies, and the trivial baselines beside them.

    Args:
        run: Run folder, or a trained model of the package: pendulum, cartpole, acrobot.
        data: Data set to score on; the one it was trained on unless told.
        protocols: Which protocols, by name; all that the data has files for unless told.
    """
    from keycld.cli.making import data_for
    from keycld.data import open_data
    from keycld.evaluation import evaluate as score
    from keycld.evaluation import evaluate_sweeps, protocol_named, protocols_for, references, save_evaluation, summary
    from keycld.training import finished, load_run, run_folder

    folder = run_folder(run)
    model, config = load_run(folder)
    if not finished(folder):
        print(f"{folder} has not trained to its end; scoring its newest checkpoint", file=sys.stderr)
    # A model of the package may come to a machine that has no data yet.
    known = config.data if Path(config.data).is_dir() else data_for(config.system)
    dataset = open_data(data or known)
    chosen = [protocol_named(name) for name in protocols] or protocols_for(dataset)
    if not chosen:
        raise KeycldError(f"{dataset.folder} has no file that a protocol scores (test.h5, validation.h5, …).")
    shared = references(dataset)
    for protocol in chosen:
        result = score(model, dataset, protocol, shared=shared)
        save_evaluation(folder, protocol.name, result)
        print(summary(result.scores), flush=True)
    if "sweeps" in dataset.splits:
        save_evaluation(folder, "sweeps", evaluate_sweeps(model, dataset))
    print(f"stored: {folder / 'evaluation'}\nnext: keycld report {folder}")
