"""arXiv v1 as published."""

import dataclasses

import jax
import optax
from jaxtyping import PRNGKeyArray

from keycld.data import WholeTrajectories
from keycld.mechanics import (
    AdaptiveDynamics,
    ConstrainedLagrangian,
    MLPInputMatrix,
    MLPPotential,
    PointMasses,
)
from keycld.models import CollocationLoss, KeyCLD
from keycld.training.presets.base import AbstractRecipe, Scene
from keycld.training.stages import Stage, forgetful
from keycld.vision import KeypointEstimator, PaperUNet, Renderer


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

    def model(self, scene: Scene, key: PRNGKeyArray) -> KeyCLD:
        """The networks of appendix A.4 and adaptive Dormand–Prince roll-outs from a difference of two frames."""
        keys = jax.random.split(key, 5)
        count = len(scene.keypoints)
        law = ConstrainedLagrangian(
            mass=PointMasses.ones(count),
            potential=MLPPotential(2 * count, key=keys[0]),
            input_matrix=MLPInputMatrix(2 * count, scene.inputs, key=keys[1]) if scene.inputs else None,
            constraint=scene.constraint,
        )
        features = (scene.height, scene.width, self.width - count)
        return KeyCLD(
            estimator=KeypointEstimator(PaperUNet(3, count, self.width, key=keys[2]), None, stride=1),
            dynamics=AdaptiveDynamics(law),
            renderer=Renderer(
                PaperUNet(self.width, 3, self.width, key=keys[3]),
                0.01 * jax.random.normal(keys[4], features),  # the default of the initialiser that A.4 names
                None,
                1,
                self.sigma,
            ),
            joined=False,
        )

    def stages(self, scene: Scene) -> tuple[Stage, ...]:
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
