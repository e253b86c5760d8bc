"""`keycld report`."""

from pathlib import Path
from typing import Annotated

import tyro


def report(run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")], /) -> None:
    """Write a run's page: movies, scores, energies, masses, training curves; opens in any browser, no network.

    Args:
        run: Run folder, evaluated with `keycld eval`; or a trained model of the package, pendulum, cartpole or acrobot,
            which is evaluated here where it has not been yet.
    """
    from keycld.reports import write_report
    from keycld.training import run_folder

    folder = run_folder(run)
    # The last thing that an evaluation leaves; a flight may have left its own results there before.
    if folder != Path(run) and not (folder / "evaluation" / "sweeps.json").exists():
        from keycld.cli.evaluate import evaluate

        evaluate(run)
    print(f"report: {write_report(folder)}")
