"""`keycld bench run | status | table | figures | report`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from keycld._errors import KeycldError

if TYPE_CHECKING:
    from keycld.benchmarks import Experiment, Place


@dataclass(frozen=True)
class Selection:
    """Which experiments, and the folders that they use.

    Args:
        suite: keycld (three systems, four models, two given frames), keycld-2024 (eight configurations, three), zoo
            (twelve mechanisms) or priors (17 sets, eight models, five given frames).
        only: Experiments with this text in their name, such as acrobot-node2.
        seeds: Such as 0,1,2; by default the suite's.
        systems: Such as pendulum,acrobot or toy/mass_spring; by default all.
        models: Such as keycld,node2; by default the suite's. `keycld models` lists all.
        preset: Preset of the training.
        set: Settings of the preset to change, such as vision.steps=500. The results get a folder of their own.
        minutes: Shorten each training so that its steps take this time on this machine; such results have a folder of
            their own. By default the preset is taken whole.
        root: Folder of data/ and runs/.
        results: Folder of the results.
    """

    suite: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SUITE")]
    only: str = ""
    seeds: str = ""
    systems: Annotated[str, tyro.conf.arg(aliases=["--sets"])] = ""
    models: str = ""
    preset: str = "fast"
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = ()
    minutes: float | None = None
    root: Path = Path(".")
    results: Path = Path("results")

    def experiments(self) -> "tuple[Experiment, ...]":
        """Return the selected experiments."""
        from keycld.benchmarks import parse_seeds, suite_named
        from keycld.cli.settings import parse_setting

        return suite_named(self.suite).select(
            only=self.only,
            seeds=parse_seeds(self.seeds),
            systems=_words(self.systems),
            models=_words(self.models),
            preset=self.preset,
            settings=dict(parse_setting(text) for text in self.set),
            minutes=self.minutes,
        )

    def place(self) -> "Place":
        """Return the folders of data, runs and results."""
        from keycld.benchmarks import Place

        return Place(self.root, self.results)


Chosen = Annotated[Selection, tyro.conf.arg(name="")]


def run(
    selection: Chosen,
    *,
    on: Literal["here", "ray"] = "here",
    cpus: float = 1.0,
    gpus: float = 0.0,
    together: int = 1,
) -> None:
    """Run what is missing or has failed: data, training, scores. It may be killed; the same command continues.

    Args:
        selection: Which experiments.
        on: here, one after the other, or ray: each a task of a Ray cluster, that of RAY_ADDRESS, of this machine, or a
            new one.
        cpus: Processor cores that an experiment reserves on Ray.
        gpus: GPUs that an experiment reserves on Ray; 0.5 lets two share one.
        together: How many experiments of one model train in one program, which on a GPU takes little longer than one
            alone; on CPUs nothing is gained.
    """
    from keycld.benchmarks import AtOnce, Here, OnRay, run_experiments

    if together < 1:
        raise KeycldError(f"--together is a number of experiments, at least 1, not {together}.")
    if together > 1 and (on == "ray" or selection.minutes is not None):
        raise KeycldError("--together is for whole trainings on this machine: leave out --on ray and --minutes.")
    experiments, place = selection.experiments(), selection.place()
    runner = OnRay(cpus, gpus) if on == "ray" else AtOnce(together) if together > 1 else Here()
    counts = run_experiments(experiments, place, runner=runner, say=lambda line: print(line, flush=True))
    print(_counts(experiments, place))
    if counts.get("failed"):
        raise KeycldError(
            f"{counts['failed']} of {sum(counts.values())} experiments failed: `keycld bench status "
            f"{selection.suite}` shows the reasons, and the same command runs them again."
        )


def status(selection: Chosen) -> None:
    """Print which experiments are done, running, failed, stale or missing."""
    from keycld.benchmarks import status_table

    experiments, place = selection.experiments(), selection.place()
    print(f"{status_table(experiments, place)}\n{_counts(experiments, place)}")


def table(selection: Chosen, *, out: Path | None = None) -> None:
    """Print the paper's table for each protocol: our scores, those of trivial predictors, and the published ones.

    Args:
        selection: Which experiments.
        out: Folder in which to write the table as table.md and table.csv too.
    """
    from keycld.benchmarks import as_csv, as_markdown, as_text, provenance, tables

    experiments, place = selection.experiments(), selection.place()
    _refuse_without_results(selection)
    found = tables(experiments, place)
    origin = provenance(experiments, place)
    print("\n\n".join(filter(None, [*(as_text(each) for each in found), origin])))
    print(f"\n{_counts(experiments, place)}")
    if out is not None:
        from keycld._files import write_text

        write_text(out / "table.md", "\n".join([*map(as_markdown, found), origin, ""]))
        write_text(out / "table.csv", as_csv(found))
        print(f"written: {out / 'table.md'}, {out / 'table.csv'}")


def figures(selection: Chosen, *, out: Path | None = None) -> None:
    """Write the KeyCLD paper's Figs. 1, 3 to 5 and 8 to 15 as far as results are stored, and movies side by side.

    Of the suite priors: frame sheets and movies of all models, and cost against score.

    Args:
        selection: Which experiments.
        out: Folder of the PNG, MP4 and GIF files; by default ROOT/runs/SUITE/PRESET/media.
    """
    from keycld.benchmarks import illustrate, illustrate_priors, suite_named

    experiments, place = selection.experiments(), selection.place()
    _refuse_without_results(selection)
    folder = out or place.group(experiments[0]) / "media"
    if suite_named(selection.suite).fitting:
        print("\n".join(map(str, illustrate_priors(experiments, place, folder))))
        return
    written = illustrate(experiments, place, folder)
    print("\n".join([*map(str, written.files), *written.paper.left_out]))


def report(selection: Chosen, *, out: Path | None = None) -> None:
    """Write one page with tables, errors over time, sheets and movies. It needs a browser, but no network.

    Args:
        selection: Which experiments.
        out: Folder of report.html and its media/; by default ROOT/runs/SUITE/PRESET.
    """
    from keycld.benchmarks import suite_named
    from keycld.reports import write_priors_report, write_suite_report

    experiments, place = selection.experiments(), selection.place()
    _refuse_without_results(selection)
    write = write_priors_report if suite_named(selection.suite).fitting else write_suite_report
    print(f"report: {write(experiments, place, out or place.group(experiments[0]))}")


def _refuse_without_results(selection: Selection) -> None:
    if not selection.results.is_dir():
        raise KeycldError(
            f"there is no folder {selection.results}: name the folder of the results with --results, or make them with "
            f"`keycld bench run {selection.suite}`."
        )


def _counts(experiments: "tuple[Experiment, ...]", place: "Place") -> str:
    from keycld.benchmarks import count_states

    return ", ".join(f"{count} {word}" for word, count in count_states(experiments, place).items())


def _words(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(",") if word.strip())
