"""The papers' experiments by name."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from keycld._errors import KeycldError, unknown
from keycld.benchmarks.experiment import DataRecipe, Experiment
from keycld.evaluation import Protocol, protocol_named
from keycld.models import models as registered

MODEL_TITLES = {"keycld": "KeyCLD", "keycld-nc": "KeyCLD-NC", "node2": "NODE2", "fc": "FC"}
"""Name and title of each model of the KeyCLD paper, in the order of its Table 1."""

_SYSTEMS = ("pendulum", "cartpole", "acrobot")
_SCORED = ("test@50", "validation@50", "test_long@200", "test_long@500")


def model_title(model: str) -> str:
    """Return the title of a model of the paper; other models go by their registered names."""
    return MODEL_TITLES.get(model, model)


@dataclass(frozen=True)
class Suite:
    """Experiments that belong together: every choice of data, model and seed.

    Attributes:
        name: of the suite.
        title: what it is, for the reader.
        data: recipes of its data sets, one a column of its table.
        models: what is trained by default.
        seeds: with which seeds by default.
        protocols: how everything is scored; the first is the headline.
    """

    name: str
    title: str
    data: tuple[DataRecipe, ...]
    models: tuple[str, ...]
    seeds: tuple[int, ...]
    protocols: tuple[Protocol, ...]

    def select(
        self,
        *,
        only: str = "",
        seeds: Sequence[int] = (),
        systems: Sequence[str] = (),
        models: Sequence[str] = (),
        preset: str = "fast",
        settings: dict[str, Any] | None = None,
    ) -> tuple[Experiment, ...]:
        """Select the experiments that fit, in the order in which they are done: seeds, then models, then data.

        Args:
            only: a part of the name.
            seeds: those to take; the suite's own where empty.
            systems: likewise.
            models: likewise.
            preset: the recipe of the training.
            settings: of the preset, where they are not its own.

        Raises:
            KeycldError: something does not exist, nothing fits, or the preset needs more frames than are given.
        """
        for kind, given, known in (("system", systems, _SYSTEMS), ("model", models, registered())):
            for name in given:
                if name not in known:
                    raise unknown(kind, name, known)
        found = [
            Experiment(self.name, data, model, preset, seed, self.protocols, dict(settings or {}))
            for seed in seeds or self.seeds
            for model in models or self.models
            for data in self.data
            if not systems or data.system in systems
        ]
        # A preset or setting that does not exist, or does not fit, is noticed before anything is done.
        needed, least = found[0].config().context, min(protocol.given for protocol in self.protocols)
        if needed > least:
            raise KeycldError(
                f"preset '{preset}'{' with --set given' if 'given' in (settings or {}) else ''} predicts from {needed} "
                f"frames, but the suite {self.name} gives {least}: take the suite keycld-2024."
            )
        fitting = tuple(experiment for experiment in found if only in experiment.name)
        if not fitting:
            raise unknown("experiment", only, [experiment.name for experiment in found])
        return fitting


SUITES = {
    suite.name: suite
    for suite in (
        Suite(
            name="keycld",
            title="KeyCLD and its ablations (arXiv v1), two given frames",
            data=tuple(DataRecipe(system) for system in _SYSTEMS),
            models=tuple(MODEL_TITLES),
            seeds=(0, 1, 2),
            protocols=tuple(protocol_named(name) for name in _SCORED),
        ),
        Suite(
            name="keycld-2024",
            title="KeyCLD in eight configurations (journal version), three given frames",
            data=tuple(
                DataRecipe(system, "keycld-2024", control)
                for system in _SYSTEMS
                for control in ("none", "under", "full")
                # A pendulum has one input: it acts or not.
                if (system, control) != ("pendulum", "under")
            ),
            models=("keycld",),
            seeds=(0,),
            protocols=tuple(protocol_named(f"{name}-given-3") for name in _SCORED),
        ),
    )
}


def suite_named(name: str) -> Suite:
    """Return the suite of that name.

    Raises:
        KeycldError: there is none; names the nearest.
    """
    if name not in SUITES:
        raise unknown("suite", name, SUITES)
    return SUITES[name]


def parse_seeds(text: str) -> tuple[int, ...]:
    """Read seeds such as `0,1,2`.

    Raises:
        KeycldError: a part is not a whole number of at least 0.
    """
    parts = [part.strip() for part in text.split(",") if part.strip()]
    for part in parts:
        if not part.isdecimal():
            raise KeycldError(f"seeds are whole numbers such as 0,1,2; '{part}' is none.")
    return tuple(int(part) for part in parts)
