"""The tables of a suite: those of its paper."""

from collections.abc import Sequence

from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.scoreboard import priors_tables
from keycld.benchmarks.suites import suite_named
from keycld.benchmarks.table import Table, seed_tables


def tables(experiments: Sequence[Experiment], place: Place) -> tuple[Table, ...]:
    """Return the tables of some experiments of one suite.

    Args:
        experiments: of one suite.
        place: where their results are.
    """
    priors = suite_named(experiments[0].suite).fitting
    return priors_tables(experiments, place) if priors else seed_tables(experiments, place)
