"""One experiment: data, model, training and scores. Its hash shows whether a recorded result still belongs to it."""

import dataclasses
import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from keycld.evaluation import Protocol
from keycld.models import ModelConfig, config_for
from keycld.systems import get


@dataclass(frozen=True)
class DataRecipe:
    """How the data of an experiment are made.

    Attributes:
        system: name of the system.
        protocol: `"keycld-2022"` (arXiv v1), `"keycld-2024"` (journal version), `"zoo"`, or `"priors"`: the one that
            the set of "Which priors matter?" has by default.
        control: which inputs act: none, under or full; by default as in the protocol.
        runs: numbers of trajectories by split, where they are not the default ones.
    """

    system: str
    protocol: str = "keycld-2022"
    control: str | None = None
    runs: tuple[tuple[str, int], ...] = ()

    @property
    def label(self) -> str:
        """The system, with the inputs that act if the recipe sets them: `cartpole-under`."""
        return self.system if self.control is None else f"{self.system}-{self.control}"

    @property
    def folder(self) -> str:
        """Name of the folder under `data/`; that of arXiv v1 is the same as for `keycld data make`."""
        usual = self.protocol in ("keycld-2022", "zoo", "priors")
        year = "" if usual else f"-{self.protocol.removeprefix('keycld-')}"
        size = "".join(f"-{number}" for _, number in self.runs)
        return self.label.replace(self.system, self.system + year, 1) + size

    def make(self, folder: Path) -> None:
        """Make all data in `folder`; finished data stay as they are, interrupted work is resumed."""
        from keycld.data import make_data  # what it draws needs JAX

        make_data(
            self.system,
            folder,
            protocol=None if self.protocol == "priors" else self.protocol,
            control=self.control,
            runs=dict(self.runs),
            all=True,
        )


@dataclass(frozen=True)
class Experiment:
    """A model trained on some data with one seed, and scored under some protocols.

    Attributes:
        suite: name of the suite that it belongs to.
        data: how its data are made.
        model: name of the model.
        preset: name of the preset.
        seed: of weights and data order.
        protocols: how it is scored; the first gives the headline score.
        settings: changed settings of the preset.
        minutes: time that the steps of the preset are shortened to; None: they are not.
    """

    suite: str
    data: DataRecipe
    model: str
    preset: str
    seed: int
    protocols: tuple[Protocol, ...]
    settings: dict[str, Any] = field(default_factory=dict)
    minutes: float | None = None

    @property
    def name(self) -> str:
        """Data, model and seed: `pendulum-keycld-0`."""
        return f"{self.data.label}-{self.model}-{self.seed}"

    @property
    def group(self) -> str:
        """Folder of experiments with the same suite and preset, `keycld/fast`; changed settings and times their own."""
        changed = f"-{digest(self.settings)[:8]}" if self.settings else ""
        short = "" if self.minutes is None else f"-{self.minutes:g}min"
        return f"{self.suite}/{self.preset}{changed}{short}"

    @property
    def chosen(self) -> ModelConfig:
        """The config of the model with the changed settings, before it knows its data.

        Raises:
            KeycldError: the model, the preset or a setting does not exist.
        """
        return config_for(self.model, self.preset, **self.settings)

    @property
    def refusal(self) -> str | None:
        """What the data lack for this model, in a few words; None where they have everything."""
        return self.chosen.refusal(get(self.data.system))

    def config(self) -> ModelConfig:
        """Return the config of the model with what it takes from the system, such as constraints.

        Raises:
            KeycldError: the model, the preset or a setting does not exist; the data lack something.
        """
        return self.chosen.completed(get(self.data.system))

    def hash(self) -> str:
        """Return the hash of all that determines the outcome: model, preset, all settings, seed, data recipe."""
        # Results were recorded when a recipe could also say how recordings begin.
        config, data = self.config(), {"initial_state": None, **dataclasses.asdict(self.data)}
        if not self.data.runs:
            # Results from before there were numbers of trajectories are of the default ones.
            del data["runs"]
        decides = {
            "model": config.model,
            "preset": config.preset,
            "settings": config.settings(),
            "seed": self.seed,
            "data": data,
        }
        if self.minutes is not None:
            decides["minutes"] = self.minutes
        return digest(decides)

    def to_json(self) -> str:
        """Return the experiment as text, for its process."""
        return json.dumps(dataclasses.asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "Experiment":
        """Return the experiment of a text that `to_json` wrote."""
        fields = json.loads(text)
        protocols = tuple(Protocol(**{**each, "thresholds": tuple(each["thresholds"])}) for each in fields["protocols"])
        runs = tuple((split, number) for split, number in fields["data"]["runs"])
        return cls(**{**fields, "data": DataRecipe(**{**fields["data"], "runs": runs}), "protocols": protocols})


@dataclass(frozen=True)
class Place:
    """Where the files of experiments are.

    Attributes:
        root: the folder with `data/` and `runs/`.
        results: the folder with one small file for each experiment that is done.
    """

    root: Path
    results: Path

    def data(self, experiment: Experiment) -> Path:
        """Return the folder of the data set, which experiments share."""
        return self.root / "data" / experiment.data.folder

    def group(self, experiment: Experiment) -> Path:
        """Return the folder of the run folders of its group."""
        return self.root / "runs" / experiment.group

    def run(self, experiment: Experiment) -> Path:
        """Return the run folder."""
        return self.group(experiment) / experiment.name

    def result(self, experiment: Experiment) -> Path:
        """Return the file of the recorded result, which is complete without the run folder."""
        return self.results / experiment.group / f"{experiment.name}.json"

    def failure(self, experiment: Experiment) -> Path:
        """Return the file of the last failure."""
        return self.results / experiment.group / f"{experiment.name}.failed.json"


def digest(value: Any) -> str:
    """Return sixteen hexadecimal digits, the hash of a JSON value."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]
