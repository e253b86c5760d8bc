"""arXiv v1 as published."""

import dataclasses

import optax
from jaxtyping import PRNGKeyArray

from keycld.data import WholeTrajectories
from keycld.models import CollocationLoss, KeyCLD
from keycld.training.presets.base import AbstractRecipe, Scene
from keycld.training.presets.parts import plain_start, published_model
from keycld.training.stages import Stage, forgetful


@dataclasses.dataclass(frozen=True)
class PaperRecipe(AbstractRecipe):
    """KeyCLD as in arXiv 2206.11030v1: one stage of 100 epochs, batches of one whole trajectory.

    About 2.3 million frames pass through networks four times as heavy as ours: 75 minutes on the authors' GPU, a day
    on two CPU cores. Errata are followed as listed in `docs/deviations.md`.

    - `width`: H of the networks. `sigma`: of the renderer's blobs. `weight`: λ. `rate`: of Adam.
    - `epochs`: passes over the training trajectories (the paper's table prints a tenth of the steps).
    - `released_optimiser`: drop the optimiser's state at every step, as the released code does.
    """

    width: int = 32
    sigma: float = 0.1
    weight: float = 5e-4
    rate: float = 3e-4
    epochs: int = 100
    released_optimiser: bool = False

    @property
    def context(self) -> int:
        """Two."""
        return 2

    def model(self, scene: Scene, key: PRNGKeyArray, kind: str = "keycld") -> KeyCLD:
        """The networks of appendix A.4 and adaptive Dormand–Prince roll-outs from a difference of two frames."""
        return published_model(scene, key, kind, width=self.width, sigma=self.sigma, start=plain_start(self.context))

    def stages(self, scene: Scene, kind: str = "keycld") -> tuple[Stage, ...]:
        """One stage; every parameter at the same rate."""
        return (
            Stage(
                name="paper",
                steps=self.epochs * scene.trajectories,
                sampler=WholeTrajectories(scene.frames),
                loss=CollocationLoss(self.weight),
                rates={"estimator": self.rate, "renderer": self.rate, "dynamics": self.rate},
                optimiser=forgetful(optax.adam) if self.released_optimiser else optax.adam,
                validate=True,
            ),
        )
