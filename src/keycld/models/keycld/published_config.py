"""What the presets of the two published versions share. Importable without JAX."""

import abc
import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from keycld.models.config import at_least_one
from keycld.models.keycld.config import KeyCLDConfig
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from jaxtyping import PRNGKeyArray

    from keycld.models.keycld.model import AbstractKeypointModel
    from keycld.stages import Group, Stage


@dataclasses.dataclass(frozen=True)
class PublishedConfig(KeyCLDConfig):
    """The networks of appendix A.4, adaptive roll-outs, and one stage of epochs over whole trajectories."""

    width: int = 32
    """`num_hidden_dim` of appendix A.4: channels of the networks, and units of V and g; NODE2 has twice as many."""
    sigma: float = 0.1
    """Width of the renderer's blobs, image-plane units."""
    distances: bool = True
    """Distance constraints measure distances, as in the released code; false: their squares."""
    tolerance: float = 1.4e-8
    """Relative and absolute tolerance of the adaptive roll-outs in predictions."""
    rate: float = 3e-4
    """Learning rate of Adam."""
    batch: int = 1
    """Trajectories a step."""
    epochs: int = 100
    """Passes over the training trajectories; the table of the paper prints a tenth of the steps."""
    released_optimiser: bool = False
    """Drop the optimiser's state at every step, as the released code does."""

    def __post_init__(self) -> None:
        """Refuse an empty batch, and no training at all."""
        super().__post_init__()
        at_least_one(self, "batch", "epochs")

    @property
    @abc.abstractmethod
    def unit_masses(self) -> bool:
        """Whether masses are 1 at first; else their square roots are from N(0, 0.01²)."""

    @property
    @abc.abstractmethod
    def pull_back(self) -> bool:
        """Whether predictions pull Φ back to its initial value."""

    def build(self, scene: Scene, key: "PRNGKeyArray") -> "AbstractKeypointModel":
        """Build the networks of appendix A.4 with adaptive Dormand–Prince roll-outs."""
        from keycld.models.keycld import published

        return published.build(self, scene, key)

    def stage(
        self, scene: Scene, loss: Any, groups: "tuple[Group, ...]", optimiser: Callable[..., Any]
    ) -> "tuple[Stage, ...]":
        """Return the only stage; its optimiser loses its state at every step where the released code is followed."""
        from keycld.data import WholeTrajectories
        from keycld.stages import Stage, forgetful

        return (
            Stage(
                name=self.preset,
                steps=self.epochs * (scene.trajectories // self.batch),
                sampler=WholeTrajectories(scene.frames, self.batch),
                loss=loss,
                groups=groups,
                optimiser=forgetful(optimiser) if self.released_optimiser else optimiser,
                validate=True,
            ),
        )
