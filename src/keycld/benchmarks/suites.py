"""Suites of experiments by name."""

import functools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from keycld._errors import KeycldError, check_minutes, check_seed, unknown
from keycld.benchmarks.experiment import DataRecipe, Experiment
from keycld.benchmarks.published_priors import FORWARD, PRIORS_TITLES
from keycld.evaluation import Protocol, protocol_named, with_given
from keycld.models import ModelConfig
from keycld.models import models as registered
from keycld.systems import AbstractSampledSystem, get, names

MODEL_TITLES = {"keycld": "KeyCLD", "keycld-nc": "KeyCLD-NC", "node2": "NODE2", "fc": "FC"}
"""Name and title of each model of the KeyCLD paper, in the order of its Table 1."""

_SYSTEMS = ("pendulum", "cartpole", "acrobot")
_ZOO = tuple(name for name in names() if name.startswith("zoo/"))
_SCORED = ("test@50", "validation@50", "test_long@200", "test_long@500")


def model_title(model: str) -> str:
    """Return the title of a model of one of the papers, or the name of any other model."""
    return (MODEL_TITLES | PRIORS_TITLES).get(model, model)


def model_order(models: Iterable[str]) -> list[str]:
    """Return each model once: those of the paper in the order of its Table 1, then the others by name."""
    paper = list(MODEL_TITLES)
    return sorted(set(models), key=lambda name: (paper.index(name) if name in paper else len(paper), name))


@dataclass(frozen=True)
class Suite:
    """All experiments with some data sets, models and seeds.

    Attributes:
        name: name of the suite.
        title: one line about it.
        data: recipes of its data sets, the columns of its table.
        models: models by default.
        seeds: seeds by default.
        protocols: how the experiments are scored; the first gives the headline score.
        fitting: whether a model gets as many frames as it needs, and protocols that it or the data cannot have are
            left out, as are data that it cannot learn. Otherwise such a model is refused.
    """

    name: str
    title: str
    data: tuple[DataRecipe, ...]
    models: tuple[str, ...]
    seeds: tuple[int, ...]
    protocols: tuple[Protocol, ...]
    fitting: bool = False

    def select(
        self,
        *,
        only: str = "",
        seeds: Sequence[int] = (),
        systems: Sequence[str] = (),
        models: Sequence[str] = (),
        preset: str = "fast",
        settings: dict[str, Any] | None = None,
        minutes: float | None = None,
    ) -> tuple[Experiment, ...]:
        """Return the selected experiments in the order of their work: by seed, then model, then data.

        Args:
            only: a part of the name.
            seeds: seeds; by default those of the suite.
            systems: systems; by default those of the suite.
            models: models; by default those of the suite.
            preset: name of the preset.
            settings: changed settings of the preset.
            minutes: time that the steps of each training are shortened to.

        Raises:
            KeycldError: a name does not exist, minutes are not positive, nothing is selected, the preset needs more
                frames than are given, or the models can learn none of the data.
        """
        check_minutes(minutes)
        moving = tuple(dict.fromkeys(data.system for data in self.data))
        listed = f"`keycld bench status {self.name}`"
        for kind, given, known, where in (
            ("system", systems, moving, listed),
            ("model", models, registered(), "`keycld models`"),
        ):
            for name in given:
                if name not in known:
                    raise unknown(kind, name, known, listed=where)
        found = [
            Experiment(self.name, data, model, preset, seed, self.protocols, dict(settings or {}), minutes)
            for seed in dict.fromkeys(seeds or self.seeds)
            for model in dict.fromkeys(models or self.models)
            for data in self.data
            if not systems or data.system in systems
        ]
        # Raises now if a preset or a setting does not exist or does not fit.
        needed = {each.model: each.chosen.context for each in found}
        least = min(protocol.given for protocol in self.protocols)
        greedy = max(needed, key=lambda model: needed[model])
        if self.fitting:
            possible = [each for each in found if each.refusal is None]
            if not possible:
                raise KeycldError(
                    f"{found[0].model} cannot learn {found[0].data.label}: {found[0].refusal}; choose other --systems "
                    "or --models."
                )
            found = [replace(each, protocols=_fitting(each.data, each.config(), self.protocols)) for each in possible]
        elif needed[greedy] > least:
            raise KeycldError(
                f"{greedy} with preset '{preset}' predicts from {needed[greedy]} frames, but the suite {self.name} "
                f"gives {least}: take the suite keycld-2024, or priors for the models of its paper."
            )
        fitting = tuple(experiment for experiment in found if only in experiment.name)
        if not fitting:
            raise unknown("experiment", only, [experiment.name for experiment in found], listed=listed)
        return fitting


def _fitting(data: DataRecipe, config: ModelConfig, protocols: tuple[Protocol, ...]) -> tuple[Protocol, ...]:
    """Return the protocols that a model and a data set can have, with as many given frames as the model needs."""
    system = get(data.system)
    long = not isinstance(system, AbstractSampledSystem) or "test_long" in system.counts["default"]
    both_ways = any(each.backward for each in protocols) and _is_reversible(config)
    return tuple(
        with_given(each, max(each.given, config.context))
        for each in protocols
        if (both_ways or not each.backward) and (long or each.split != "test_long")
    )


@functools.cache
def _is_reversible(config: ModelConfig) -> bool:
    from keycld.models.listing import is_reversible  # builds the model, with JAX

    return is_reversible(config)


def _priors_data() -> tuple[DataRecipe, ...]:
    """Return the sets of the second paper with 2,000 trajectories; of molecules 70 share a simulation."""
    return tuple(
        DataRecipe(system, "priors", runs=(("train", 2100 if system.startswith("md/") else 2000), ("test", 200)))
        for system in FORWARD
    )


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
                # A pendulum has one input, which acts or not.
                if (system, control) != ("pendulum", "under")
            ),
            models=("keycld",),
            seeds=(0,),
            protocols=tuple(protocol_named(f"{name}-given-3") for name in _SCORED),
        ),
        Suite(
            name="zoo",
            title="twelve mechanisms, one recipe, motions taken up anywhere",
            data=tuple(DataRecipe(system, "zoo") for system in _ZOO),
            models=("keycld",),
            seeds=(0, 1, 2),
            protocols=tuple(protocol_named(name) for name in _SCORED[:3]),
        ),
        Suite(
            name="priors",
            title="the models of “Which priors matter?” and KeyCLD on its 17 data sets, five given frames",
            data=_priors_data(),
            models=(*PRIORS_TITLES, "keycld"),
            seeds=(0,),
            protocols=tuple(
                protocol_named(name)
                for name in (
                    "test@256-priors",
                    "test@256-priors-backward",
                    "test@124-priors",
                    "test@256-priors-of-200",
                    "test@256-priors-of-200-backward",
                    "test_long@1000-priors",
                )
            ),
            fitting=True,
        ),
    )
}


def suite_named(name: str) -> Suite:
    """Return a suite by name.

    Raises:
        KeycldError: there is none; names the nearest one.
    """
    if name not in SUITES:
        raise unknown("suite", name, SUITES)
    return SUITES[name]


def parse_seeds(text: str) -> tuple[int, ...]:
    """Read seeds such as `0,1,2`.

    Raises:
        KeycldError: a part is no seed.
    """
    parts = [part.strip() for part in text.split(",") if part.strip()]
    for part in parts:
        if not part.isdecimal():
            raise KeycldError(f"seeds are whole numbers such as 0,1,2, not '{part}'.")
        check_seed(int(part))
    return tuple(int(part) for part in parts)
