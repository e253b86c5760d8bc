"""One experiment: which data, which model, trained how, scored how. Its hash says whether a result is still its own."""

import dataclasses
import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from keycld.data import make_data
from keycld.evaluation import Protocol
from keycld.models import ModelConfig, config_for
from keycld.systems import get


@dataclass(frozen=True)
class DataRecipe:
    """How an experiment's data are made.

    Attributes:
        system: what moves.
        protocol: `"keycld-2022"` (arXiv v1) or `"keycld-2024"` (journal version).
        control: which inputs act, instead of the protocol's choice: none, under or full.
        start: how runs start, instead of the protocol's choice.
    """

    system: str
    protocol: str = "keycld-2022"
    control: str | None = None
    start: str | None = None

    @property
    def label(self) -> str:
        """The system, and which inputs act where that is part of the recipe: `cartpole-under`."""
        return self.system if self.control is None else f"{self.system}-{self.control}"

    @property
    def folder(self) -> str:
        """Name of the folder under `data/`; the protocol of arXiv v1 is where `keycld data make` puts it."""
        year = "" if self.protocol == "keycld-2022" else f"-{self.protocol.removeprefix('keycld-')}"
        return self.label.replace(self.system, self.system + year, 1)

    def make(self, folder: Path) -> None:
        """Make the data in `folder`; finished ones are left as they are, interrupted work is taken up."""
        make_data(self.system, folder, protocol=self.protocol, control=self.control, start=self.start)


@dataclass(frozen=True)
class Experiment:
    """A model trained on some data with one seed, and scored under some protocols.

    Attributes:
        suite: the name of the suite that it belongs to.
        data: how its data are made.
        model: name of what is trained.
        preset: the whole recipe's name.
        seed: of weights and data order.
        protocols: how it is scored; the first is the headline.
        settings: of the preset, where they are not its own.
    """

    suite: str
    data: DataRecipe
    model: str
    preset: str
    seed: int
    protocols: tuple[Protocol, ...]
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Data, model and seed: `pendulum-keycld-0`."""
        return f"{self.data.label}-{self.model}-{self.seed}"

    @property
    def group(self) -> str:
        """Folder of its kind: `keycld/fast`; changed settings have a folder of their own."""
        changed = f"-{digest(self.settings)[:8]}" if self.settings else ""
        return f"{self.suite}/{self.preset}{changed}"

    def config(self) -> ModelConfig:
        """Return the model's config with the changed settings, and as many given frames as are scored with.

        Raises:
            KeycldError: the model, the preset or a setting does not exist.
        """
        config = config_for(self.model, self.preset, **self.settings)
        if "given" in config.settings() and "given" not in self.settings:
            config = config.changed({"given": self.protocols[0].given})
        return config.completed(get(self.data.system))

    def hash(self) -> str:
        """Return the hash of all that decides the outcome: model, preset, all settings, seed, data recipe."""
        config = self.config()
        decides = {
            "model": config.model,
            "preset": config.preset,
            "settings": config.settings(),
            "seed": self.seed,
            "data": dataclasses.asdict(self.data),
        }
        return digest(decides)

    def to_json(self) -> str:
        """The experiment as text, for the process that does it."""
        return json.dumps(dataclasses.asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "Experiment":
        """What `to_json` wrote."""
        fields = json.loads(text)
        protocols = tuple(Protocol(**{**each, "thresholds": tuple(each["thresholds"])}) for each in fields["protocols"])
        return cls(**{**fields, "data": DataRecipe(**fields["data"]), "protocols": protocols})


@dataclass(frozen=True)
class Place:
    """Where the files of experiments lie.

    Attributes:
        root: has `data/` and `runs/`.
        results: has one small file for each experiment that is done.
    """

    root: Path
    results: Path

    def data(self, experiment: Experiment) -> Path:
        """Folder of the data set, which experiments share."""
        return self.root / "data" / experiment.data.folder

    def group(self, experiment: Experiment) -> Path:
        """Folder of the run folders of its kind."""
        return self.root / "runs" / experiment.group

    def run(self, experiment: Experiment) -> Path:
        """The run folder."""
        return self.group(experiment) / experiment.name

    def result(self, experiment: Experiment) -> Path:
        """The recorded outcome, which counts without the run folder."""
        return self.results / experiment.group / f"{experiment.name}.json"

    def failure(self, experiment: Experiment) -> Path:
        """What went wrong at the last try."""
        return self.results / experiment.group / f"{experiment.name}.failed.json"


def digest(value: Any) -> str:
    """Sixteen hexadecimal digits that stand for a value of JSON."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]
