"""The method of the 2024 version."""

import dataclasses
from typing import TYPE_CHECKING

from keycld.models.keycld.config import MODELS
from keycld.models.keycld.published_config import PublishedConfig
from keycld.models.registry import register_preset
from keycld.models.scene import Scene

if TYPE_CHECKING:
    import optax

    from keycld.stages import Stage


@register_preset("journal", *MODELS)
@dataclasses.dataclass(frozen=True)
class JournalConfig(PublishedConfig):
    """KeyCLD as in Neurocomputing 573:127175 (2024): short roll-outs, augmentation, 40 epochs of whole trajectories.

    It needs three given frames: the state is at the second, its velocity a central difference. Predictions do not pull
    Φ back to its initial value. About 0.9 million frames pass through the paper's networks: five minutes on an
    NVIDIA H200, 18 hours on one CPU core.
    """

    sigma: float = 0.1
    """Width of the renderer's blobs and of the heat maps' targets, image-plane units."""
    epochs: int = 40
    """Passes over the training trajectories."""
    predicted: int = 4
    """Frames of a roll-out in the loss."""
    dynamics_weight: float = 1.0
    """Weight of the squared distances of the roll-outs."""
    heat_map_weight: float = 1.0
    """Weight of the heat maps' cross-entropy."""
    augment: bool = True
    """Turn and mirror what the estimator sees."""
    dynamics_share: float = 0.2
    """Learning rate of masses, potential and input matrix as a share of `rate`."""
    clip: float = 5.0
    """Each component of a gradient is cut to ± this."""

    @property
    def context(self) -> int:
        """Three."""
        return 3

    @property
    def unit_masses(self) -> bool:
        """Yes."""
        return True

    @property
    def pull_back(self) -> bool:
        """No."""
        return False

    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return one stage with a slower rate for the dynamics."""
        import optax

        from keycld.models.keycld.short_rollout_loss import ShortRolloutLoss
        from keycld.stages import Group, part

        def adam(schedule: "optax.Schedule") -> "optax.GradientTransformation":
            return optax.chain(optax.clip(self.clip), optax.adam(schedule))

        loss = ShortRolloutLoss(
            steps=self.predicted,
            dynamics=self.dynamics_weight,
            heat_map=self.heat_map_weight,
            sigma=self.sigma,
            augment=self.augment,
        )
        groups = (
            Group("vision", part("estimator", "renderer"), self.rate),
            Group("dynamics", part("dynamics"), self.dynamics_share * self.rate),
        )
        return self.stage(scene, loss, groups, adam)
