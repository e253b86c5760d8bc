"""Several copies of a system in MuJoCo, simulated and rendered in worker processes."""

from collections.abc import Sequence
from types import TracebackType

import numpy as np

from keycld.systems import AbstractMujocoSystem, Task, Workers, advance_in_worker, render_in_worker


class Plant:
    """`n` copies of a system, advanced together. A context manager: its workers end with it.

    MuJoCo makes one step a frame, as in the data. The plant does not limit the input; the agent does.

    Args:
        system: simulated by MuJoCo.
        states: [n, d], initial states.
        workers: processes that simulate and render; by default one a core.
    """

    def __init__(self, system: AbstractMujocoSystem, states: np.ndarray, workers: int | None = None):
        self.system = system
        self.state = np.array(states, float)
        self._workers = Workers(workers)

    def __enter__(self) -> "Plant":
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._workers.close()

    def look(self) -> np.ndarray:
        """Return pictures of the present states, uint8 [n, H, W, 3]."""
        parts = self._split(len(self.state))
        answers = self._workers.run([Task(render_in_worker, (self.system, self.state[part])) for part in parts])
        return np.concatenate([answer.image for answer in answers])

    def advance(self, inputs: np.ndarray) -> np.ndarray:
        """Hold `inputs [n, l]` for one frame; return pictures of the states after it."""
        parts = self._split(len(self.state))
        tasks = [Task(advance_in_worker, (self.system, self.state[part], inputs[part])) for part in parts]
        answers = self._workers.run(tasks)
        self.state = np.concatenate([answer.state for answer in answers])
        return np.concatenate([answer.frames for answer in answers])

    def _split(self, count: int) -> Sequence[slice]:
        edges = np.linspace(0, count, min(count, self._workers.count) + 1).astype(int)
        return [slice(first, last) for first, last in zip(edges[:-1], edges[1:], strict=True)]
