"""The method of the 2024 version."""

import dataclasses

import optax
from jaxtyping import PRNGKeyArray

from keycld.data import WholeTrajectories
from keycld.models import KeyCLD, ShortRolloutLoss
from keycld.training.presets.base import AbstractRecipe, Scene
from keycld.training.presets.parts import plain_start, published_model
from keycld.training.stages import Stage, forgetful


@dataclasses.dataclass(frozen=True)
class JournalRecipe(AbstractRecipe):
    """KeyCLD as in Neurocomputing 573:127175 (2024): short roll-outs, augmentation, 40 epochs of whole trajectories.

    Made for three given frames: its state is at the second, with a central difference for the velocity. About 0.9
    million frames pass through the paper's networks: a GPU's work.

    - `width`: H of the networks. `sigma`: of the renderer's blobs and of the heat maps' targets (the text does not
      give it; 0.05 is what the released ablations of that version use).
    - `predicted`: frames of a roll-out. `dynamics_weight`, `heat_map_weight`: of the loss terms beside the
      reconstruction, whose weight is 1. `augment`: turn and mirror what the estimator sees.
    - `rate`: of Adam for estimator and renderer. `dynamics_share`: of it for masses, potential and input matrix.
    - `clip`: each component of a gradient is cut to ± this.
    - `epochs`: passes over the training trajectories.
    - `released_optimiser`: drop the optimiser's state at every step, as the released code does.
    """

    width: int = 32
    sigma: float = 0.05
    predicted: int = 4
    dynamics_weight: float = 1.0
    heat_map_weight: float = 1.0
    augment: bool = True
    rate: float = 3e-4
    dynamics_share: float = 0.2
    clip: float = 5.0
    epochs: int = 40
    released_optimiser: bool = False

    @property
    def context(self) -> int:
        """Three."""
        return 3

    def model(self, scene: Scene, key: PRNGKeyArray, kind: str = "keycld") -> KeyCLD:
        """The paper's networks and adaptive roll-outs from a central difference of three frames."""
        return published_model(scene, key, kind, width=self.width, sigma=self.sigma, start=plain_start(self.context))

    def stages(self, scene: Scene, kind: str = "keycld") -> tuple[Stage, ...]:
        """One stage with a slower rate for the dynamics."""

        def adam(schedule: optax.Schedule) -> optax.GradientTransformation:
            return optax.chain(optax.clip(self.clip), optax.adam(schedule))

        loss = ShortRolloutLoss(
            steps=self.predicted,
            dynamics=self.dynamics_weight,
            heat_map=self.heat_map_weight,
            sigma=self.sigma,
            augment=self.augment,
        )
        rates = {"estimator": self.rate, "renderer": self.rate, "dynamics": self.dynamics_share * self.rate}
        return (
            Stage(
                name="journal",
                steps=self.epochs * scene.trajectories,
                sampler=WholeTrajectories(scene.frames),
                loss=loss,
                rates=rates,
                optimiser=forgetful(adam) if self.released_optimiser else adam,
                validate=True,
            ),
        )
