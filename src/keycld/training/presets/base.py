"""What a preset is: settings, a model, and the stages that train it."""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any

from jaxtyping import PRNGKeyArray

from keycld.mechanics import AbstractConstraint
from keycld.models import AbstractModel
from keycld.training.stages import Stage

MODELS = {
    "keycld": "the whole of it",
    "keycld-nc": "without the constraint function",
    "node2": "a second-order neural ODE instead of the Lagrangian",
    "fc": "fully connected observer and renderer instead of heat maps",
}
"""The model of the paper and its ablations; a recipe builds and trains each of them, all else equal that fits it."""


@dataclasses.dataclass(frozen=True)
class Scene:
    """What a recipe must know of the data to build a model; never anything measured on test data.

    - `height`, `width`: of the pictures, pixels.
    - `inputs`: l, the number of inputs.
    - `frames`: of a training trajectory.
    - `trajectories`: how many there are.
    - `keypoints`: their names.
    - `constraint`: Φ.
    """

    height: int
    width: int
    inputs: int
    frames: int
    trajectories: int
    keypoints: tuple[str, ...]
    constraint: AbstractConstraint | Callable


@dataclasses.dataclass(frozen=True)
class AbstractRecipe(abc.ABC):
    """A frozen dataclass of settings that makes a model and its stages; saved whole in `config.json`."""

    @property
    @abc.abstractmethod
    def context(self) -> int:
        """How many frames a prediction starts from."""

    @abc.abstractmethod
    def model(self, scene: Scene, key: PRNGKeyArray, kind: str = "keycld") -> AbstractModel:
        """A model with fresh weights; `kind` is a name of `MODELS`."""

    @abc.abstractmethod
    def stages(self, scene: Scene, kind: str = "keycld") -> tuple[Stage, ...]:
        """What is trained, in order."""

    def settings(self) -> dict[str, Any]:
        """The settings as JSON."""
        return dataclasses.asdict(self)
