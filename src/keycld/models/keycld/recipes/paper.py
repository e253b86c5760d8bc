"""arXiv v1 as published."""

import dataclasses
from typing import TYPE_CHECKING

from keycld.models.keycld.config import MODELS
from keycld.models.keycld.published_config import PublishedConfig
from keycld.models.registry import register_preset
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from keycld.stages import Stage


@register_preset("paper", *MODELS)
@dataclasses.dataclass(frozen=True)
class PaperConfig(PublishedConfig):
    """KeyCLD as in arXiv 2206.11030v1: one stage of 100 epochs, batches of one whole trajectory.

    About 2.3 million frames pass through networks with four times the cost of ours: 75 minutes on the authors' GPU,
    seven on an NVIDIA H200, 42 hours on one CPU core. Predictions have a first velocity from a difference of two
    frames, and pull Φ back to its initial value. `docs/deviations.md` lists the errata that are followed.
    """

    unit_masses: bool = False
    """Initial masses of 1, as in the 2024 code; false: square roots from N(0, 0.01²), as in the code of arXiv v1."""
    weight: float = 5e-4
    """λ of eq. (13)."""

    @property
    def context(self) -> int:
        """Two."""
        return 2

    @property
    def pull_back(self) -> bool:
        """Yes."""
        return True

    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return one stage with every parameter at the same rate."""
        import optax

        from keycld.models.keycld.collocation_loss import CollocationLoss
        from keycld.stages import Group, part

        everything = Group("model", part("estimator", "renderer", "dynamics"), self.rate)
        return self.stage(scene, CollocationLoss(self.weight), (everything,), optax.adam)
