"""arXiv v1 as published."""

import dataclasses
from typing import TYPE_CHECKING

from keycld.models.config import at_least_one
from keycld.models.keycld.config import MODELS, KeyCLDConfig
from keycld.models.registry import register_preset
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from jaxtyping import PRNGKeyArray

    from keycld.models.keycld.model import AbstractKeypointModel
    from keycld.stages import Stage


@register_preset("paper", *MODELS)
@dataclasses.dataclass(frozen=True)
class PaperConfig(KeyCLDConfig):
    """KeyCLD as in arXiv 2206.11030v1: one stage of 100 epochs, batches of one whole trajectory.

    About 2.3 million frames pass through networks with four times the cost of ours: 75 minutes on the authors' GPU, a
    day on two CPU cores. `docs/deviations.md` lists the errata that are followed.
    """

    width: int = 32
    """`num_hidden_dim` of appendix A.4: channels of the networks, and units of V and g; NODE2 has twice as many."""
    sigma: float = 0.1
    """Width of the renderer's blobs, image-plane units."""
    unit_masses: bool = False
    """Initial masses of 1, as in the 2024 code; false: square roots from N(0, 0.01²), as in the code of arXiv v1."""
    distances: bool = True
    """Distance constraints measure distances, as in the released code; false: their squares."""
    tolerance: float = 1.4e-8
    """Relative and absolute tolerance of the adaptive roll-outs in predictions."""
    weight: float = 5e-4
    """λ of eq. (13)."""
    rate: float = 3e-4
    """Learning rate of Adam."""
    batch: int = 1
    """Trajectories a step."""
    epochs: int = 100
    """Passes over the training trajectories; the table of the paper prints a tenth of the steps."""
    released_optimiser: bool = False
    """Drop the optimiser's state at every step, as the released code does."""

    def __post_init__(self) -> None:
        """Refuse an empty batch."""
        super().__post_init__()
        at_least_one(self, "batch")

    @property
    def context(self) -> int:
        """Two."""
        return 2

    def build(self, scene: Scene, key: "PRNGKeyArray") -> "AbstractKeypointModel":
        """Build the networks of appendix A.4 with adaptive Dormand–Prince roll-outs from a difference of two frames."""
        from keycld.models.keycld import published

        return published.build(
            self,
            scene,
            key,
            width=self.width,
            sigma=self.sigma,
            unit_masses=self.unit_masses,
            distances=self.distances,
            tolerance=self.tolerance,
            pull_back=True,
        )

    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return one stage with every parameter at the same rate."""
        import optax

        from keycld.data import WholeTrajectories
        from keycld.models.keycld.losses import CollocationLoss
        from keycld.stages import Group, Stage, forgetful

        return (
            Stage(
                name="paper",
                steps=self.epochs * (scene.trajectories // self.batch),
                sampler=WholeTrajectories(scene.frames, self.batch),
                loss=CollocationLoss(self.weight),
                groups=(Group("model", lambda m: (m.estimator, m.renderer, m.dynamics), self.rate),),
                optimiser=forgetful(optax.adam) if self.released_optimiser else optax.adam,
                validate=True,
            ),
        )
