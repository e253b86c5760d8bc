"""The default recipe: best quality in the least time."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from keycld._errors import KeycldError
from keycld.data import RandomFrames, StartGroups
from keycld.mechanics import (
    RK4,
    AffineMLPInputMatrix,
    AffineMLPPotential,
    ConstrainedLagrangian,
    CoupledMasses,
    MechanicalDynamics,
    PointMasses,
    Rattle,
    SecondOrderNetwork,
    as_constraint,
)
from keycld.models import AbstractStart, Beginning, FittedStart, KeyCLD, PredictionLoss, TrackLoss, VisionLoss
from keycld.training.presets.base import AbstractRecipe, Scene
from keycld.training.presets.parts import check_sizes, plain_start
from keycld.training.presets.prepare import (
    cache_keypoints,
    fit_dynamics,
    in_turn,
    measure_beginning,
    measure_statistics,
    share_constants,
    tell_unseen,
)
from keycld.training.stages import Stage, muon, warmup_cosine
from keycld.vision import (
    AbstractEstimator,
    AbstractRenderer,
    DenseEstimator,
    DenseRenderer,
    KeypointEstimator,
    LightUNet,
    Renderer,
    Standardise,
)

_AFFINE = ("potential", "input_matrix")


@dataclasses.dataclass(frozen=True)
class FastRecipe(AbstractRecipe):
    """See first, then move, then both: minutes on two CPU cores.

    1. `vision`: single frames; reconstruction, focused heat maps, constant constraint values.
    2. `dynamics`: roll-outs on cached keypoints, no pictures.
    3. `joint`: everything together, drawn from motions that start at two frames anywhere.
    4. `long`: the same to the end of the recordings.
    5. `beginning`: no steps; measures what recordings begin with. Then the validation score.

    Before 3 and 4 least squares fit the dynamics to whole trajectories.

    - `width`: of the networks at half resolution. `stride`: pixels a heat-map cell.
    - `sigma`: width of the renderer's blobs, image-plane units.
    - `substeps`: RATTLE steps a frame.
    - `coupled_masses`: a full mass matrix between keypoints, for links whose mass is spread out, instead of eq. (14).
    - `shared_constants`: all trajectories show one machine with one set of lengths; false: each has its own.
    - `candidates`, `trial`: random starts of the vision stage that are tried for so many steps; the best goes on.
    - `*_steps`, `*_batch`, `*_rate`: of each stage.
    - `given`: frames that a prediction starts from; 3 in the 2024 protocol.
    - `groups`: of so many frames each in a clip. `begin`: share of the clips that begin where a trajectory does.
      `*_horizons`: frames that a clip spans, growing during the stage.
    """

    width: int = 16
    stride: int = 2
    sigma: float = 0.1
    substeps: int = 4
    coupled_masses: bool = True
    shared_constants: bool = True
    vision_steps: int = 1000
    candidates: int = 4
    trial: int = 200
    vision_batch: int = 16
    vision_rate: float = 1e-2
    dynamics_steps: int = 600
    dynamics_batch: int = 16
    dynamics_rate: float = 1e-2
    dynamics_horizons: tuple[int, ...] = (8, 24)
    joint_steps: int = 1500
    joint_horizons: tuple[int, ...] = (8, 16, 32)
    long_steps: int = 3600
    long_horizons: tuple[int, ...] = (32, 50)
    joint_batch: int = 2
    joint_rate: float = 2e-3
    energy_rate: float = 1e-3
    groups: int = 4
    begin: float = 0.5
    given: int = 2

    def __post_init__(self) -> None:
        """Counts of things that there must be at least one of."""
        counts = ("stride", "substeps", "candidates", "trial", "groups", "given")
        self._check_counts(*counts, "vision_batch", "dynamics_batch", "joint_batch")

    def _check_counts(self, *names: str) -> None:
        for name in names:
            if getattr(self, name) < 1:
                raise KeycldError(f"setting {name} is at least 1, not {getattr(self, name)}.")

    @property
    def context(self) -> int:
        """As told."""
        return self.given

    def model(self, scene: Scene, key: PRNGKeyArray, kind: str = "keycld") -> KeyCLD:
        """KeyCLD with light U-Nets at half resolution, affine parts in V and g, and RATTLE.

        Without constraints RATTLE is the Störmer–Verlet method, which serves KeyCLD-NC. NODE2 uses Runge–Kutta 4 and
        a difference for the start velocity: it has no law that a start could be fitted through.
        """
        check_sizes(scene, self.width, self.stride)
        keys = jax.random.split(key, 5)
        return KeyCLD(
            estimator=self._estimator(scene, keys[2], dense=kind == "fc"),
            dynamics=self._dynamics(scene, keys[0], keys[1], kind),
            renderer=self._renderer(scene, keys[3], keys[4], dense=kind == "fc"),
            start=self._start(scene, kind),
            beginning=None if kind == "node2" else Beginning.unknown(),
        )

    def _dynamics(self, scene: Scene, first: PRNGKeyArray, second: PRNGKeyArray, kind: str) -> MechanicalDynamics:
        dim = 2 * len(scene.keypoints)
        if kind == "node2":
            return MechanicalDynamics(SecondOrderNetwork(dim, scene.inputs, key=first), RK4())
        law = ConstrainedLagrangian(
            mass=(CoupledMasses if self.coupled_masses else PointMasses).ones(len(scene.keypoints)),
            potential=AffineMLPPotential(dim, key=first),
            input_matrix=AffineMLPInputMatrix(dim, scene.inputs, key=second) if scene.inputs else None,
            constraint=None if kind == "keycld-nc" else scene.constraint,
        )
        return MechanicalDynamics(law, Rattle(substeps=self.substeps))

    def _start(self, scene: Scene, kind: str) -> AbstractStart:
        if kind == "node2":
            return plain_start(self.given)
        # A posture of no meaning, until the constants are measured on the first keypoints.
        posture = jnp.linspace(-0.4, 0.6, 2 * len(scene.keypoints))
        law = as_constraint(scene.constraint, posture.size)
        shared = law(posture) if kind != "keycld-nc" else posture[:0]
        return FittedStart(shared if self.shared_constants else None, self.given)

    def _estimator(self, scene: Scene, key: PRNGKeyArray, dense: bool) -> AbstractEstimator:
        count = len(scene.keypoints)
        standardise = Standardise(jnp.zeros((scene.height, scene.width, 3)), jnp.ones(()))
        if dense:
            return DenseEstimator((scene.height, scene.width), count, self.width, standardise, self.stride, key=key)
        return KeypointEstimator(LightUNet(3 * self.stride**2, count, self.width, key=key), standardise, self.stride)

    def _renderer(self, scene: Scene, key: PRNGKeyArray, features: PRNGKeyArray, dense: bool) -> AbstractRenderer:
        count, grey = len(scene.keypoints), jnp.full((scene.height, scene.width, 3), 0.5)
        if dense:
            return DenseRenderer((scene.height, scene.width), count, self.width, grey, self.stride, key=key)
        shape = (scene.height // self.stride, scene.width // self.stride, self.width - count)
        return Renderer(
            LightUNet(self.width, 3 * self.stride**2, self.width, key=key),
            0.1 * jax.random.normal(features, shape),
            grey,
            self.stride,
            self.sigma,
        )

    def stages(self, scene: Scene, kind: str = "keycld") -> tuple[Stage, ...]:
        """Vision, dynamics, joint, long, beginning; horizons longer than the trajectories are cut."""
        vision = Stage(
            name="vision",
            steps=self.vision_steps,
            sampler=RandomFrames(self.vision_batch),
            loss=VisionLoss(steps=self.vision_steps),
            rates={"estimator": self.vision_rate, "renderer": self.vision_rate},
            optimiser=muon,
            schedule=warmup_cosine,
            clip=1e3,
            prepare=measure_statistics,
            candidates=self.candidates,
            trial=self.trial,
            remark=tell_unseen,
        )
        # Affine energies and inputs first: with noisy keypoints the perceptrons would learn the noise.
        frozen = {} if kind == "node2" else {f"dynamics.law.{part}.perceptron": 0.0 for part in _AFFINE}

        def clips(batch: int, horizons: tuple[int, ...], steps: int, cached: bool = False) -> StartGroups:
            within = tuple(min(horizon, scene.frames) for horizon in horizons)
            groups = min(self.groups, max(1, min(within) // self.given))
            return StartGroups(batch, groups, within, steps, cached, self.given, self.begin)

        dynamics = Stage(
            name="dynamics",
            steps=self.dynamics_steps,
            sampler=clips(self.dynamics_batch, self.dynamics_horizons, self.dynamics_steps, cached=True),
            loss=TrackLoss(),
            rates={"dynamics": self.dynamics_rate, **frozen},
            schedule=functools.partial(warmup_cosine, final=0.1),
            clip=1.0,
            prepare=in_turn(cache_keypoints, share_constants),
        )
        joint = Stage(
            name="joint",
            steps=self.joint_steps,
            sampler=clips(self.joint_batch, self.joint_horizons, self.joint_steps),
            loss=PredictionLoss(),
            rates={
                "estimator": self.joint_rate,
                "renderer": self.joint_rate,
                "dynamics": self.energy_rate,
            },
            optimiser=muon,
            schedule=warmup_cosine,
            clip=1e3,
            prepare=fit_dynamics,
        )
        long = dataclasses.replace(
            joint,
            name="long",
            steps=self.long_steps,
            sampler=clips(self.joint_batch, self.long_horizons, self.long_steps),
            prepare=in_turn(cache_keypoints, share_constants, fit_dynamics),
        )
        begin = dataclasses.replace(
            long, name="beginning", steps=0, prepare=in_turn(cache_keypoints, measure_beginning), validate=True
        )
        return vision, dynamics, joint, long, begin
