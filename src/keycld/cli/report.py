"""`keycld report`."""

from pathlib import Path

import tyro


def report(run: tyro.conf.Positional[Path], /) -> None:
    """Write a run's page: movies, scores, energies, masses, training curves; opens in any browser, no network.

    Args:
        run: Run folder, evaluated with `keycld eval`.
    """
    from keycld.reports import write_report

    print(f"report: {write_report(run)}")
