"""The experiments of the papers as code: runs, protocols, tables, figures."""

from typing import TYPE_CHECKING

from keycld._lazy import lazily
from keycld.benchmarks.tables import tables as tables

if TYPE_CHECKING:
    # `keycld bench run` waits for other processes, and imports what it needs of this, without models.
    from keycld.benchmarks.experiment import DataRecipe as DataRecipe
    from keycld.benchmarks.experiment import Experiment as Experiment
    from keycld.benchmarks.experiment import Place as Place
    from keycld.benchmarks.figures import error_figure as error_figure
    from keycld.benchmarks.illustrations import Illustration as Illustration
    from keycld.benchmarks.illustrations import Illustrations as Illustrations
    from keycld.benchmarks.illustrations import illustrate as illustrate
    from keycld.benchmarks.on_ray import OnRay as OnRay
    from keycld.benchmarks.pictures import movie_of as movie_of
    from keycld.benchmarks.priors_figures import cost_figure as cost_figure
    from keycld.benchmarks.priors_figures import illustrate_priors as illustrate_priors
    from keycld.benchmarks.priors_figures import shown_protocols as shown_protocols
    from keycld.benchmarks.published_figures import PaperFigure as PaperFigure
    from keycld.benchmarks.published_figures import PaperFigures as PaperFigures
    from keycld.benchmarks.published_figures import paper_figures as paper_figures
    from keycld.benchmarks.run_figures import control_strip as control_strip
    from keycld.benchmarks.run_figures import grid_pictures as grid_pictures
    from keycld.benchmarks.run_figures import observation_sheet as observation_sheet
    from keycld.benchmarks.run_figures import potential_figures as potential_figures
    from keycld.benchmarks.running import AbstractRunner as AbstractRunner
    from keycld.benchmarks.running import AtOnce as AtOnce
    from keycld.benchmarks.running import Here as Here
    from keycld.benchmarks.running import run_experiments as run_experiments
    from keycld.benchmarks.scoreboard import Board as Board
    from keycld.benchmarks.scoreboard import average_ranks as average_ranks
    from keycld.benchmarks.scoreboard import boards as boards
    from keycld.benchmarks.status import Status as Status
    from keycld.benchmarks.status import count_states as count_states
    from keycld.benchmarks.status import status_of as status_of
    from keycld.benchmarks.status import status_table as status_table
    from keycld.benchmarks.suites import MODEL_TITLES as MODEL_TITLES
    from keycld.benchmarks.suites import SUITES as SUITES
    from keycld.benchmarks.suites import Suite as Suite
    from keycld.benchmarks.suites import model_title as model_title
    from keycld.benchmarks.suites import parse_seeds as parse_seeds
    from keycld.benchmarks.suites import suite_named as suite_named
    from keycld.benchmarks.table import Table as Table
    from keycld.benchmarks.table import as_csv as as_csv
    from keycld.benchmarks.table import as_markdown as as_markdown
    from keycld.benchmarks.table import as_text as as_text
    from keycld.benchmarks.table import done_results as done_results
    from keycld.benchmarks.table import over_seeds as over_seeds
    from keycld.benchmarks.table import provenance as provenance

__getattr__ = lazily(__name__)

__all__ = [
    "MODEL_TITLES",
    "model_title",
    "SUITES",
    "AbstractRunner",
    "AtOnce",
    "Board",
    "DataRecipe",
    "Experiment",
    "Here",
    "Illustration",
    "Illustrations",
    "OnRay",
    "PaperFigure",
    "PaperFigures",
    "Place",
    "Status",
    "Suite",
    "Table",
    "as_csv",
    "average_ranks",
    "boards",
    "as_markdown",
    "as_text",
    "control_strip",
    "cost_figure",
    "count_states",
    "done_results",
    "error_figure",
    "grid_pictures",
    "illustrate",
    "illustrate_priors",
    "movie_of",
    "observation_sheet",
    "over_seeds",
    "paper_figures",
    "parse_seeds",
    "potential_figures",
    "provenance",
    "run_experiments",
    "shown_protocols",
    "status_of",
    "status_table",
    "suite_named",
    "tables",
]
