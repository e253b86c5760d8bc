"""The default recipe: best quality in the least time."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from keycld.data import RandomFrames, StartAndLater
from keycld.mechanics import (
    AffineMLPInputMatrix,
    AffineMLPPotential,
    ConstrainedLagrangian,
    MechanicalDynamics,
    PointMasses,
    Rattle,
)
from keycld.models import KeyCLD, PredictionLoss, TrackLoss, VisionLoss
from keycld.training.presets.base import AbstractRecipe, Scene
from keycld.training.presets.prepare import cache_keypoints, measure_statistics
from keycld.training.stages import Stage, warmup_cosine
from keycld.vision import KeypointEstimator, LightUNet, Renderer, Standardise


@dataclasses.dataclass(frozen=True)
class FastRecipe(AbstractRecipe):
    """See first, then move, then both: minutes on two CPU cores.

    1. `vision`: single frames; reconstruction, focused heat maps, constant constraint values.
    2. `dynamics`: roll-outs on cached keypoints, no pictures.
    3. `joint`: everything together, drawn from motions that start at two given frames.

    - `width`: of the networks at half resolution. `stride`: pixels a heat-map cell.
    - `sigma`: width of the renderer's blobs, image-plane units.
    - `substeps`: RATTLE steps a frame.
    - `*_steps`, `*_batch`, `*_rate`: of each stage.
    - `later`: later frames drawn a clip. `*_horizons`: frames that a clip spans, growing during the stage.
    """

    width: int = 16
    stride: int = 2
    sigma: float = 0.1
    substeps: int = 4
    vision_steps: int = 1500
    vision_batch: int = 16
    vision_rate: float = 2e-3
    dynamics_steps: int = 600
    dynamics_batch: int = 64
    dynamics_rate: float = 1e-2
    dynamics_horizons: tuple[int, ...] = (8, 24)
    joint_steps: int = 6000
    joint_batch: int = 2
    joint_rate: float = 1e-3
    joint_horizons: tuple[int, ...] = (8, 16, 32, 50)
    later: int = 6

    def model(self, scene: Scene, key: PRNGKeyArray) -> KeyCLD:
        """KeyCLD with light U-Nets at half resolution, affine parts in V and g, and RATTLE."""
        keys = jax.random.split(key, 5)
        count, size = len(scene.keypoints), (scene.height, scene.width, 3)
        channels = 3 * self.stride**2
        law = ConstrainedLagrangian(
            mass=PointMasses.ones(count),
            potential=AffineMLPPotential(2 * count, key=keys[0]),
            input_matrix=AffineMLPInputMatrix(2 * count, scene.inputs, key=keys[1]) if scene.inputs else None,
            constraint=scene.constraint,
        )
        features = (scene.height // self.stride, scene.width // self.stride, self.width - count)
        return KeyCLD(
            estimator=KeypointEstimator(
                LightUNet(channels, count, self.width, key=keys[2]),
                Standardise(jnp.zeros(size), jnp.ones(())),
                self.stride,
            ),
            dynamics=MechanicalDynamics(law, Rattle(substeps=self.substeps)),
            renderer=Renderer(
                LightUNet(self.width, channels, self.width, key=keys[3]),
                0.1 * jax.random.normal(keys[4], features),
                jnp.full(size, 0.5),
                self.stride,
                self.sigma,
            ),
        )

    def _perceptrons(self, scene: Scene) -> dict[str, float]:
        names = ("potential", "input_matrix") if scene.inputs else ("potential",)
        return {f"dynamics.law.{name}.perceptron": 0.0 for name in names}

    def stages(self, scene: Scene) -> tuple[Stage, ...]:
        """Vision, dynamics, joint; horizons longer than the trajectories are cut."""
        vision = Stage(
            name="vision",
            steps=self.vision_steps,
            sampler=RandomFrames(self.vision_batch),
            loss=VisionLoss(),
            rates={"estimator": self.vision_rate, "renderer": self.vision_rate},
            schedule=warmup_cosine,
            clip=1e3,
            prepare=measure_statistics,
        )

        def clips(batch: int, horizons: tuple[int, ...], steps: int, cached: bool = False) -> StartAndLater:
            within = tuple(min(horizon, scene.frames) for horizon in horizons)
            return StartAndLater(batch, min(self.later, min(within) - 2), within, steps, cached)

        dynamics = Stage(
            name="dynamics",
            steps=self.dynamics_steps,
            sampler=clips(self.dynamics_batch, self.dynamics_horizons, self.dynamics_steps, cached=True),
            loss=TrackLoss(),
            # Affine energies and inputs first: with noisy keypoints the perceptrons would learn the noise.
            rates={"dynamics": self.dynamics_rate, **self._perceptrons(scene)},
            schedule=functools.partial(warmup_cosine, final=0.1),
            clip=1.0,
            prepare=cache_keypoints,
        )
        joint = Stage(
            name="joint",
            steps=self.joint_steps,
            sampler=clips(self.joint_batch, self.joint_horizons, self.joint_steps),
            loss=PredictionLoss(),
            rates={"estimator": self.joint_rate, "renderer": self.joint_rate, "dynamics": self.joint_rate},
            schedule=warmup_cosine,
            clip=1e3,
            validate=True,
        )
        return vision, dynamics, joint
