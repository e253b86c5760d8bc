"""`keycld eval`."""

import sys
from pathlib import Path

import tyro

from keycld import KeycldError


def evaluate(
    run: tyro.conf.Positional[Path],
    /,
    *,
    data: str | None = None,
    protocols: tuple[str, ...] = (),
) -> None:
    """Score a trained run: VPT, error over time, true-state error, energies, and the trivial baselines beside them.

    Args:
        run: Run folder.
        data: Data set to score on; the one it was trained on unless told.
        protocols: Which protocols, by name; all that the data has files for unless told.
    """
    from keycld.data import open_data
    from keycld.evaluation import evaluate as score
    from keycld.evaluation import evaluate_sweeps, protocol_named, protocols_for, references, save_evaluation, summary
    from keycld.training import finished, load_run

    model, config = load_run(run)
    if not finished(run):
        print(f"{run} has not trained to its end; scoring its newest checkpoint", file=sys.stderr)
    dataset = open_data(data or config.data)
    chosen = [protocol_named(name) for name in protocols] or protocols_for(dataset)
    if not chosen:
        raise KeycldError(f"{dataset.folder} has no file that a protocol scores (test.h5, validation.h5, …).")
    shared = references(dataset)
    for protocol in chosen:
        result = score(model, dataset, protocol, shared=shared)
        save_evaluation(run, protocol.name, result)
        print(summary(result.scores), flush=True)
    if "sweeps" in dataset.splits:
        save_evaluation(run, "sweeps", evaluate_sweeps(model, dataset))
    print(f"stored: {run / 'evaluation'}\nnext: keycld report {run}")
