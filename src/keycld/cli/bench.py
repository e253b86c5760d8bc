"""`keycld bench run | status | table | figures | report`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from keycld._errors import KeycldError

if TYPE_CHECKING:
    from keycld.benchmarks import Experiment, Place


@dataclass(frozen=True)
class Selection:
    """Which experiments, and where they lie.

    Args:
        suite: keycld (three systems, four models, two given frames) or keycld-2024 (eight configurations, three).
        only: Those with this in their name, such as acrobot-node2.
        seeds: Such as 0,1,2. Default: the suite's.
        systems: Such as pendulum,acrobot. Default: all.
        models: Such as keycld,node2; `keycld models` lists all. Default: the suite's.
        preset: The recipe of the training.
        set: Settings of the preset to change, as in `keycld train`; such results lie in a folder of their own.
        root: Folder of data/ and runs/.
        results: Folder of the results.
    """

    suite: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SUITE")]
    only: str = ""
    seeds: str = ""
    systems: str = ""
    models: str = ""
    preset: str = "fast"
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = ()
    root: Path = Path(".")
    results: Path = Path("results")

    def experiments(self) -> "tuple[Experiment, ...]":
        """The experiments that are meant."""
        from keycld.benchmarks import parse_seeds, suite_named
        from keycld.cli.settings import parse_setting

        return suite_named(self.suite).select(
            only=self.only,
            seeds=parse_seeds(self.seeds),
            systems=_words(self.systems),
            models=_words(self.models),
            preset=self.preset,
            settings=dict(parse_setting(text) for text in self.set),
        )

    def place(self) -> "Place":
        """Where they lie."""
        from keycld.benchmarks import Place

        return Place(self.root, self.results)


Chosen = Annotated[Selection, tyro.conf.arg(name="")]


def run(selection: Chosen) -> None:
    """Do what is missing or failed: data, training, scores. Kill it at any moment; the same command goes on."""
    from keycld.benchmarks import run_experiments

    experiments, place = selection.experiments(), selection.place()
    counts = run_experiments(experiments, place, say=lambda line: print(line, flush=True))
    print(_counts(experiments, place))
    if counts.get("failed"):
        raise KeycldError(
            f"{counts['failed']} of {sum(counts.values())} experiments failed: `keycld bench status "
            f"{selection.suite}` says how; the same command tries them again."
        )


def status(selection: Chosen) -> None:
    """Tell which experiments are done, running, failed, stale or missing."""
    from keycld.benchmarks import status_table

    experiments, place = selection.experiments(), selection.place()
    print(f"{status_table(experiments, place)}\n{_counts(experiments, place)}")


def table(selection: Chosen, *, out: Path | None = None) -> None:
    """Print the paper's table with ours, trivial predictors' and published scores, for each protocol.

    Args:
        selection: Which experiments.
        out: Folder for the same as table.md and table.csv.
    """
    from keycld.benchmarks import as_csv, as_markdown, as_text, provenance, tables

    experiments, place = selection.experiments(), selection.place()
    found = tables(experiments, place)
    origin = provenance(experiments, place)
    print("\n\n".join([*(as_text(each) for each in found), origin]))
    print(f"\n{_counts(experiments, place)}")
    if out is not None:
        from keycld._files import write_text

        write_text(out / "table.md", "\n".join([*map(as_markdown, found), origin, ""]))
        write_text(out / "table.csv", as_csv(found))
        print(f"written: {out / 'table.md'}, {out / 'table.csv'}")


def figures(selection: Chosen, *, out: Path | None = None) -> None:
    """Draw the error over time (Fig. 3), sheets of all models (Figs. 4 and 13 to 15) and movies side by side.

    Args:
        selection: Which experiments.
        out: Folder of the PNG, MP4 and GIF files; ROOT/runs/SUITE/PRESET/media unless told.
    """
    from keycld.benchmarks import illustrate

    experiments, place = selection.experiments(), selection.place()
    for path in illustrate(experiments, place, out or place.group(experiments[0]) / "media").files:
        print(path)


def report(selection: Chosen, *, out: Path | None = None) -> None:
    """Write one page with tables, errors over time, sheets and movies; opens in any browser, no network.

    Args:
        selection: Which experiments.
        out: Folder of report.html and its media/; ROOT/runs/SUITE/PRESET unless told.
    """
    from keycld.reports import write_suite_report

    experiments, place = selection.experiments(), selection.place()
    print(f"report: {write_suite_report(experiments, place, out or place.group(experiments[0]))}")


def _counts(experiments: "tuple[Experiment, ...]", place: "Place") -> str:
    from keycld.benchmarks import count_states

    return ", ".join(f"{count} {word}" for word, count in count_states(experiments, place).items())


def _words(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(",") if word.strip())
