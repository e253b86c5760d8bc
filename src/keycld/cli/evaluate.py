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
    from keycld.evaluation import (
        evaluate_sweeps,
        protocol_named,
        save_evaluation,
        standard_protocols,
        summary,
    )
    from keycld.training import finished, load_run

    model, config = load_run(run)
    if not finished(run):
        print(f"{run} has not trained to its end; scoring its newest checkpoint", file=sys.stderr)
    dataset = open_data(data or config.data)
    chosen = [protocol_named(name) for name in protocols] or [
        p for p in standard_protocols() if (dataset.folder / f"{p.split}.h5").exists()
    ]
    if not chosen:
        raise KeycldError(f"{dataset.folder} has no file that a protocol scores (test.h5, validation.h5, …).")
    for protocol in chosen:
        result = score(model, dataset, protocol)
        save_evaluation(run, protocol.name, result)
        print(summary(result.scores))
    if (dataset.folder / "sweeps.h5").exists():
        save_evaluation(run, "sweeps", evaluate_sweeps(model, dataset))
    print(f"stored: {run / 'evaluation'}\nnext: keycld report {run}")
