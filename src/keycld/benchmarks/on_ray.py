"""Experiments as tasks of a Ray cluster."""

import contextlib
import importlib
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from keycld._errors import KeycldError
from keycld._lock import holder
from keycld.benchmarks.experiment import Experiment, Place
from keycld.benchmarks.results import record_failure
from keycld.benchmarks.running import AbstractRunner, attempt
from keycld.benchmarks.status import LOCK, status_of

# Times that Ray begins a task again whose worker has died. The training resumes at its newest checkpoint.
_RETRIES = 3
# The process of an experiment ends soon after the worker that began it.
_SETTLING_SECONDS = 10.0


@dataclass(frozen=True)
class OnRay(AbstractRunner):
    """Each experiment a task of a Ray cluster, as many at the same time as its resources allow.

    The cluster is that of the environment variable RAY_ADDRESS, else one that runs on this machine, else a new one that
    ends with this process. All its machines have keycld installed and see the folders of `place` under the same path.

    Attributes:
        cpus: processor cores that an experiment reserves.
        gpus: GPUs that it reserves; 0.5: two experiments share one.

    Good values: with GPUs `gpus=1`, `cpus=4`. On processors a training uses one to two cores well.
    """

    cpus: float = 1.0
    gpus: float = 0.0

    def __post_init__(self):
        """Refuse numbers that Ray takes for no resources."""
        finite = math.isfinite(self.cpus + self.gpus)
        if not (finite and min(self.cpus, self.gpus) >= 0 < max(self.cpus, self.gpus)):
            raise KeycldError(
                f"--cpus and --gpus are at least 0, and one of them is above 0, not {self.cpus:g} and {self.gpus:g}."
            )
        if self.gpus > 1 and self.gpus % 1:
            raise KeycldError(f"--gpus is a share of one GPU or a whole number, not {self.gpus:g}.")

    def each(
        self, experiments: Sequence[Experiment], place: Place, child: Sequence[str]
    ) -> Iterator[tuple[Experiment, float, int]]:
        """Attempt all experiments, as the abstract method says; those whose workers die are attempted again.

        Raises:
            KeycldError: Ray is not installed, or no machine of the cluster has the resources.
        """
        ray = _ray()
        whole = Place(place.root.resolve(), place.results.resolve())
        with _connected(ray):
            together = self._together(ray)
            task = ray.remote(num_cpus=self.cpus, num_gpus=self.gpus, max_retries=_RETRIES)(_task)
            waiting = {task.remote(experiment, whole, tuple(child)): experiment for experiment in experiments}
            while waiting:
                (ready,), _ = ray.wait(list(waiting), num_returns=1)
                experiment, seconds = waiting.pop(ready), 0.0
                try:
                    seconds = ray.get(ready)
                except ray.exceptions.RayError as error:
                    if status_of(experiment, place).word != "done":
                        sentence = (str(error).strip().splitlines() or ["no message"])[0]
                        record_failure(experiment, place, "its Ray task", type(error).__name__, sentence)
                yield experiment, seconds, max(1, min(together, len(waiting)))

    def _together(self, ray: Any) -> int:
        """Return how many experiments the cluster's machines run at the same time."""
        wanted = {"CPU": self.cpus, "GPU": self.gpus}
        machines = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        fitting = sum(min(int(has.get(name, 0.0) / each) for name, each in wanted.items() if each) for has in machines)
        if not fitting:
            raise KeycldError(
                f"no machine of the Ray cluster has {self.cpus:g} processor cores and {self.gpus:g} GPUs for an "
                "experiment: reserve fewer with --cpus and --gpus."
            )
        return fitting


def _ray() -> Any:
    try:
        return importlib.import_module("ray")
    except ImportError:
        raise KeycldError("--on ray needs its package: pip install 'keycld[ray]'.") from None


@contextlib.contextmanager
def _connected(ray: Any) -> Iterator[None]:
    """Connect to a cluster for the time of the body, unless this process is connected already."""
    if ray.is_initialized():
        yield
        return
    ray.init(include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    try:
        yield
    finally:
        ray.shutdown()


def _task(experiment: Experiment, place: Place, child: Sequence[str]) -> float:
    """Attempt an experiment in a worker, after the process of a worker that died has released its lock."""
    until = time.monotonic() + _SETTLING_SECONDS
    while holder(place.run(experiment) / LOCK) is not None and time.monotonic() < until:
        time.sleep(0.1)
    return attempt([experiment], place, child)
