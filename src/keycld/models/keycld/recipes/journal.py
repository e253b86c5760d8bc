"""The method of the 2024 version."""

import dataclasses
from typing import TYPE_CHECKING

from keycld.models.config import at_least_one
from keycld.models.keycld.config import MODELS, KeyCLDConfig
from keycld.models.registry import register_preset
from keycld.models.scene import Scene

if TYPE_CHECKING:
    import optax
    from jaxtyping import PRNGKeyArray

    from keycld.models.keycld.model import AbstractKeypointModel
    from keycld.stages import Stage


@register_preset("journal", *MODELS)
@dataclasses.dataclass(frozen=True)
class JournalConfig(KeyCLDConfig):
    """KeyCLD as in Neurocomputing 573:127175 (2024): short roll-outs, augmentation, 40 epochs of whole trajectories.

    It needs three given frames: the state is at the second, its velocity a central difference. Predictions do not pull
    Φ back to its initial value. About 0.9 million frames pass through the paper's networks: use a GPU.
    """

    width: int = 32
    """`num_hidden_dim`: channels of the networks, and units of V and g; NODE2 has twice as many."""
    sigma: float = 0.1
    """Width of the renderer's blobs and of the targets of the heat maps, image-plane units."""
    distances: bool = True
    """Distance constraints measure distances, as in the released code; false: their squares."""
    tolerance: float = 1.4e-8
    """Relative and absolute tolerance of the adaptive roll-outs in predictions."""
    predicted: int = 4
    """Frames of a roll-out in the loss."""
    dynamics_weight: float = 1.0
    """Weight of the squared distances of the roll-outs."""
    heat_map_weight: float = 1.0
    """Weight of the cross-entropy of the heat maps."""
    augment: bool = True
    """Rotate and mirror the frames that the estimator gets, at random."""
    rate: float = 3e-4
    """Learning rate of Adam for estimator and renderer."""
    dynamics_share: float = 0.2
    """The learning rate of masses, potential and input matrix, as a share of `rate`."""
    clip: float = 5.0
    """Each component of a gradient is clipped to ± this value."""
    batch: int = 1
    """Trajectories a step."""
    epochs: int = 40
    """Passes over the training trajectories."""
    released_optimiser: bool = False
    """Drop the optimiser's state at every step, as the released code does."""

    def __post_init__(self) -> None:
        """Refuse an empty batch."""
        super().__post_init__()
        at_least_one(self, "batch")

    @property
    def context(self) -> int:
        """Three."""
        return 3

    def build(self, scene: Scene, key: "PRNGKeyArray") -> "AbstractKeypointModel":
        """Build the paper's networks with adaptive roll-outs from a central difference of three frames."""
        from keycld.models.keycld import published

        return published.build(
            self,
            scene,
            key,
            width=self.width,
            sigma=self.sigma,
            unit_masses=True,
            distances=self.distances,
            tolerance=self.tolerance,
            pull_back=False,
        )

    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return one stage with a slower rate for the dynamics."""
        import optax

        from keycld.data import WholeTrajectories
        from keycld.models.keycld.short_rollout_loss import ShortRolloutLoss
        from keycld.stages import Group, Stage, forgetful

        def adam(schedule: "optax.Schedule") -> "optax.GradientTransformation":
            return optax.chain(optax.clip(self.clip), optax.adam(schedule))

        loss = ShortRolloutLoss(
            steps=self.predicted,
            dynamics=self.dynamics_weight,
            heat_map=self.heat_map_weight,
            sigma=self.sigma,
            augment=self.augment,
        )
        return (
            Stage(
                name="journal",
                steps=self.epochs * (scene.trajectories // self.batch),
                sampler=WholeTrajectories(scene.frames, self.batch),
                loss=loss,
                groups=(
                    Group("vision", lambda m: (m.estimator, m.renderer), self.rate),
                    Group("dynamics", lambda m: m.dynamics, self.dynamics_share * self.rate),
                ),
                optimiser=forgetful(adam) if self.released_optimiser else adam,
                validate=True,
            ),
        )
