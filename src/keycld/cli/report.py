"""`keycld report`."""

from pathlib import Path
from typing import Annotated

import tyro


def report(run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")], /) -> None:
    """Write a run's page: movies, scores, energies, masses, training curves. It needs a browser, but no network.

    Args:
        run: Run folder that `keycld eval` has scored, or a trained model of the package (pendulum, cartpole, acrobot),
            which is scored first if necessary.
    """
    from keycld.reports import write_report
    from keycld.training import run_folder

    folder = run_folder(run)
    # `keycld eval` writes this file last. `keycld control` may have written other results to the folder before.
    if folder != Path(run) and not (folder / "evaluation" / "sweeps.json").exists():
        from keycld.cli.evaluate import evaluate

        evaluate(run)
    print(f"report: {write_report(folder)}")
