"""The stored results of a run folder; any of them may be missing."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import numpy as np

from keycld._errors import KeycldError
from keycld._records import read_json, read_lines
from keycld.evaluation import MOTION, PHYSICS, Evaluation, Physics, load_evaluation, load_physics
from keycld.training import read_verdict


@dataclass(frozen=True)
class Run:
    """The stored results of one run.

    Attributes:
        folder: the run folder.
        config: `config.json`.
        environment: `environment.json`, {} if absent.
        metrics: the lines of `metrics.jsonl`, [] if absent.
        evaluations: the files of `evaluation/*.json` with scores under a protocol, by name; shortest horizon first.
        sweeps: potential energies along paths, None if absent.
        controls: closed-loop runs by name.
        failures: what failed in each attempt of the training, in a sentence each.
        failed: whether the last of them ended the training.
        motion: how the motion of a clip was followed and predicted, None if absent.
        physics: physical constants of a clip, None if absent.
    """

    folder: Path
    config: dict[str, Any]
    environment: dict[str, Any]
    metrics: list[dict[str, Any]]
    evaluations: dict[str, Evaluation]
    sweeps: dict[str, np.ndarray] | None
    controls: dict[str, Evaluation]
    failures: list[str]
    failed: bool
    motion: Evaluation | None = None
    physics: Physics | None = None

    @property
    def name(self) -> str:
        """The name of the system; that of the folder for a clip, because its data are called `data`."""
        clip = self.motion is not None or self.physics is not None
        return self.folder.resolve().name if clip else str(self.config.get("system", "a system"))

    @property
    def headline(self) -> Evaluation | None:
        """The evaluation at the top of the page: test recordings at the paper's horizon, if there are any.

        Results on another data set, whose names have its name as a suffix, come last.
        """
        if not self.evaluations:
            return None
        own = {name: each for name, each in self.evaluations.items() if name == each.scores["protocol"]["name"]}
        found = own or self.evaluations
        unseen = [each for each in found.values() if each.scores["protocol"]["split"] == "test"]
        return found.get("test@50") or [*unseen, *found.values()][0]

    @property
    def long(self) -> dict[str, Evaluation]:
        """The evaluations on longer recordings than that of the headline, by name, shortest first."""
        if self.headline is None:
            return {}
        least = self.headline.scores["protocol"]["horizon"]
        return {name: each for name, each in self.evaluations.items() if each.scores["protocol"]["horizon"] > least}


class _Line(TypedDict):
    step: int
    stage: NotRequired[str]
    seconds: NotRequired[float]
    cpu_seconds: NotRequired[float]
    frames: NotRequired[int]


def read_run(folder: str | Path) -> Run:
    """Read a run folder.

    Raises:
        KeycldError: it is not one, or a file in it is damaged.
    """
    folder = Path(folder)
    if not (folder / "config.json").exists():
        raise KeycldError(f"'{folder}' is not a run folder: it has no config.json; train one with `keycld train`.")
    names = sorted({path.stem for path in (folder / "evaluation").glob("*.json")} - {PHYSICS})
    results = {name: load_evaluation(folder, name) for name in names}
    scored = {name: result for name, result in results.items() if "protocol" in result.scores}
    sweeps = results["sweeps"].arrays if "sweeps" in results else None
    verdict = read_verdict(folder) or {"passed": True, "failures": []}
    return Run(
        folder=folder,
        config=_json(folder / "config.json"),
        environment=_json(folder / "environment.json"),
        metrics=read_lines(folder / "metrics.jsonl", _Line),
        evaluations=dict(sorted(scored.items(), key=lambda item: item[1].scores["protocol"]["horizon"])),
        sweeps=sweeps if sweeps else None,
        controls={name: result for name, result in results.items() if "law" in result.scores},
        failures=verdict["failures"],
        failed=not verdict["passed"],
        motion=results.get(MOTION),
        physics=load_physics(folder) if (folder / "evaluation" / f"{PHYSICS}.json").exists() else None,
    )


def _json(path: Path) -> dict[str, Any]:
    try:
        return read_json(path, dict[str, Any], "restore it or train again")
    except FileNotFoundError:
        return {}
