"""The default preset: best quality in the least time."""

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from keycld._errors import KeycldError
from keycld.models.config import ModelConfig, at_least_one
from keycld.models.keycld.config import MODELS, MOST_ORDERED, KeyCLDConfig
from keycld.models.registry import register_preset
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from jaxtyping import PRNGKeyArray

    from keycld.models.base import AbstractModel
    from keycld.models.keycld.model import AbstractKeypointModel
    from keycld.models.keycld.selection import Tried
    from keycld.stages import Stage


@dataclasses.dataclass(frozen=True)
class VisionStage:
    """Estimator and renderer on single frames: reconstruction, narrow heat maps, even values of the constraints."""

    steps: int = 1000
    """Optimiser steps."""
    batch: int = 16
    """Frames a step."""
    rate: float = 1e-2
    """Peak learning rate of estimator and renderer."""
    candidates: int = 4
    """Random initialisations to try; the best one continues."""
    trial: int = 250
    """Steps of each trial."""
    heat_map: float = 1.0
    """Weight of the cross-entropy between a heat map and a Gaussian at its own keypoint."""
    sigma: float = 0.05
    """Width of that Gaussian, image-plane units; at least ¾ of a heat-map cell."""
    constraint: tuple[float, float] = (100.0, 1000.0)
    """Weight of the penalty on constraints that vary over a batch, at the first and at the last step; linear in
    between.
    """
    coupling: float = 10.0
    """Initial value of this weight for constraints on several keypoints; above zero."""
    joints: float = 0.85
    """Share of the steps, from the first one on, in which the gradient of constraints between keypoints moves joints
    only, not free ends.
    """
    coverage: float = 10.0
    """Initial weight of the gradient that pulls keypoints to what the rendered frames lack; zero from a quarter of the
    steps on, and after the trials. `fast` and `control` use it in every second trial, `clip` in all.
    """
    spread: float = 0.1
    """Initial width of the region around a keypoint in that gradient, image-plane units; 0.1 from a fifth of the steps
    on. In `clip`, half of the trials use 0.1 throughout.
    """
    patches: tuple[float, float] = (2.0, 0.0)
    """Weight of how alike the image patches around each keypoint are over all frames: its value at 0.35 of the steps,
    and its value from 0.7 on.
    """
    patch: float = 0.06
    """Width of these patches, image-plane units."""
    worst: float = 0.2
    """Reconstruction error, as a share of the mean frame's, above which the stage has failed."""


@dataclasses.dataclass(frozen=True)
class DynamicsStage:
    """Dynamics alone. All settings but `worst` are for NODE2, which has no Lagrangian to identify."""

    steps: int = 600
    """Optimiser steps of NODE2; a Lagrangian is identified instead and takes none."""
    batch: int = 16
    """Clips a step."""
    rate: float = 1e-2
    """Peak learning rate of the dynamics."""
    horizons: tuple[int, ...] = (8, 24)
    """Frames that a clip spans; each value holds for an equal part of the steps."""
    scale: float = 0.1
    """Distance, image-plane units, beyond which an error counts linearly instead of squared."""
    worst: float = 0.1
    """The stage fails if the error of the fitted motions is larger than this share of the error of motions with
    constant acceleration, and the errors of the keypoints do not explain it. With 1 or more the law is not judged.
    """


@dataclasses.dataclass(frozen=True)
class JointStage:
    """All parts together: frames rendered from roll-outs from any two consecutive frames."""

    steps: int = 2000
    """Optimiser steps."""
    horizons: tuple[int, ...] = (8, 16, 32, 50, 50)
    """Frames that a clip spans; each value holds for an equal part of the steps."""
    fit_every: int = 400
    """Steps between least-squares fits of the dynamics."""
    batch: int = 2
    """Clips a step."""
    rate: float = 2e-3
    """Peak learning rate of estimator and renderer."""
    energy_rate: float = 1e-3
    """Peak learning rate of the dynamics."""
    track: float = 3000.0
    """Weight of the squared distance between rolled-out and observed keypoints."""
    scale: float = 0.03
    """Distance, image-plane units, beyond which an error counts linearly instead of squared."""
    constraint: float = 100.0
    """Weight of the unevenness of the constraints."""
    heat_map: float = 1.0
    """Weight of the cross-entropy between a heat map and a Gaussian at its own keypoint."""
    sigma: float = 0.05
    """Width of that Gaussian, image-plane units; at least ¾ of a heat-map cell."""


_LOOKS = 4
# Settings that stand in the records of trainings that need them alone, so that older records hold.
_WHERE_NEEDED = ("looks", "own_parameters", "exchange", "discs")
_FLAT = {
    **{f"vision_{name}": f"vision.{name}" for name in ("steps", "batch", "rate")},
    **{name: f"vision.{name}" for name in ("candidates", "trial")},
    **{f"dynamics_{name}": f"dynamics.{name}" for name in ("steps", "batch", "rate", "horizons")},
    **{f"joint_{name}": f"joint.{name}" for name in ("batch", "rate")},
    "energy_rate": "joint.energy_rate",
    "begin": "first_frames",
}
"""Settings of schema 1 that are still known, with the current names."""


@register_preset("fast", *MODELS)
@dataclasses.dataclass(frozen=True)
class FastConfig(KeyCLDConfig):
    """The default preset: vision first, then dynamics, then both together; minutes on two CPU cores.

    1. `vision`: single frames.
    2. `dynamics`: no steps; identifies the forces that act, and their strength, from the keypoints of whole recordings.
    3. `joint`: all parts together, over growing horizons; every 400 steps a least-squares fit of the dynamics to whole
       recordings.
    4. `prior`: no steps; looks whether the parts are discs (`fit_discs`), fits once more and measures the velocity
       prior. Then the validation score.
    """

    RENAMED: ClassVar[dict[str, str]] = KeyCLDConfig.RENAMED | {
        "dynamics.law.potential.perceptron.": "dynamics.law.potential.terms.perceptron-32.perceptron.",
    }

    OWN: ClassVar[bool] = True
    """Whether the preset can learn trajectories with parameters of their own."""

    TOLERATED: ClassVar[float] = 0.05
    """Pixels of error that the law may have at the end of the training, however small the keypoints' own errors are."""

    width: int = 16
    """Channels of the networks at half resolution."""
    stride: int = 2
    """Pixels of a heat-map cell."""
    sigma: float = 0.1
    """Width of the renderer's blobs, image-plane units."""
    substeps: int = 4
    """RATTLE steps for each frame."""
    coupled_masses: bool = True
    """A full mass matrix between keypoints, for links with distributed mass, instead of the diagonal of eq. (14)."""
    terms: tuple[str, ...] | None = None
    """Kinds of forces besides an affine V: springs, pairs, anchors, perceptron, viscous, joints, coulomb, drag; by
    default those that the motion asks for."""
    input_width: int = 0
    """Width of a perceptron in g. 0: g is affine."""
    looks: int | None = None
    """Numbers that describe how each part looks, such as its colour, where recordings differ in it; by default 4 where
    the system says that they do, else none."""
    shared_constants: bool = True
    """All trajectories show one mechanism with one set of lengths; false: each trajectory has its own."""
    own_parameters: bool | None = None
    """Each trajectory has its own position offset, and its own factors of the masses and of friction. Default: true if
    the system declares that these differ. When false, only the constants of the constraints may differ between
    trajectories.
    """
    exchange: bool | None = None
    """The parts may swap their appearance between recordings, so the constraints must tell which keypoint is which
    part. Default: true if there are looks, and two to six keypoints with constraints whose constants are shared or
    around own places.
    """
    discs: bool | None = None
    """Keypoints are the centres of soft discs that are fitted to each frame. Default: if the training finds that such
    discs explain the pictures; false: never.
    """
    velocity_prior: bool = True
    """Predictions use a prior of the initial velocity, measured on the training recordings, of which many begin at rest
    or shortly after; false: no prior.
    """
    groups: int = 4
    """Pairs of consecutive frames in a clip."""
    first_frames: float = 0.5
    """Share of the clips that contain the first frames of a trajectory."""
    vision: VisionStage = VisionStage()
    """First stage."""
    dynamics: DynamicsStage = DynamicsStage()
    """Second stage."""
    joint: JointStage = JointStage()
    """Third stage."""

    def __post_init__(self) -> None:
        """Refuse counts below one."""
        super().__post_init__()
        at_least_one(self, "stride", "substeps", "groups")
        at_least_one(self.vision, "candidates", "trial", "batch")
        at_least_one(self.dynamics, "batch")
        at_least_one(self.joint, "batch", "fit_every")
        if self.own_parameters and (self.model != "keycld" or not self.OWN):
            raise KeycldError(
                "own_parameters are learned by the model keycld with the preset fast alone: leave the setting out, or "
                "choose these."
            )

    def completed(self, source: Any = None) -> "ModelConfig":
        """Return the config with its constraints, and with looks where those of the source's recordings differ."""
        config = super().completed(source)
        assert isinstance(config, FastConfig)
        if config.looks is None and source is not None and source.looks_differ and self.model != "fc":
            config = dataclasses.replace(config, looks=_LOOKS)
        own = self.model == "keycld" and self.OWN and source is not None and source.parameters_differ
        if config.own_parameters is None and own:
            config = dataclasses.replace(config, own_parameters=True)
        told_apart = bool(config.model == "keycld" and 1 < config.keypoints <= MOST_ORDERED and config.phi.items)
        told_apart = told_apart and bool(config.looks and (config.shared_constants or config.own_parameters))
        if config.exchange is None and told_apart:
            config = dataclasses.replace(config, exchange=True)
        if config.exchange and not told_apart:
            raise KeycldError(
                f"exchange needs the model keycld with looks (--looks 4), constraints on 2 to {MOST_ORDERED} "
                "keypoints, and shared constants or own parameters: leave the setting out, or choose these."
            )
        return config

    def settings(self) -> dict[str, Any]:
        """Return all fields as JSON values; what may differ by recording only where it does: older records hold."""
        found = super().settings()
        return {name: value for name, value in found.items() if name not in _WHERE_NEEDED or value is not None}

    @property
    def context(self) -> int:
        """Two; more given frames make better predictions."""
        return 2

    @property
    def tried(self) -> "Tried | None":
        """The forces that training tries, and what they must be worth to stay; None: they are given by `terms`."""
        from keycld.models.keycld.selection import Tried

        return Tried() if self.terms is None else None

    def migrated(self, settings: Mapping[str, Any], version: int) -> Mapping[str, Any]:
        """Return settings of schema 1, which were flat, 2, which had two joint stages, 3, without terms, and 4 to 6.

        In schema 4 patches were compared for clips alone, by settings of the preset. Before 7 keypoints covered the
        same width from the first step.
        """
        settings = {**settings, "vision": {"spread": 0.1, **settings.get("vision", {})}}
        if version > 4:
            return settings
        if version == 1:
            settings = {_FLAT.get(name, name): value for name, value in settings.items()}
        weight = settings.get("rigid", 0.0)
        patches = {"patches": (weight, weight)} | ({"patch": settings["patch"]} if "patch" in settings else {})
        settings = {name: value for name, value in settings.items() if name not in ("rigid", "patch")}
        settings["vision"] = {**settings.get("vision", {}), **patches}
        if version == 4:
            return settings
        gone = ("given", "long", "joint_steps", "joint_horizons", "long_steps", "long_horizons")
        kept = {name: value for name, value in settings.items() if name not in gone}
        if version == 3:
            return kept | {"terms": ["perceptron"] if kept.pop("potential_width") else []}
        # The one joint stage keeps the preset's own steps and horizons: those of the two do not fit it.
        joint = {name: value for name, value in kept.get("joint", {}).items() if name not in ("steps", "horizons")}
        return kept | ({"joint": joint} if joint else {}) | {"terms": ["perceptron-32"], "input_width": 32}

    def matching(self, model: "AbstractModel") -> "FastConfig":
        """Return the config with the terms of the model's V and R, and with discs, which training may have found."""
        from keycld.mechanics import terms_of
        from keycld.models.keycld.model import KeyCLD

        if not isinstance(model, KeyCLD):
            return self
        found = model.part_light is not None and not self.own_parameters
        return dataclasses.replace(self, terms=tuple(terms_of(model.law)), discs=found or self.discs)

    def build(self, scene: Scene, key: "PRNGKeyArray") -> "AbstractKeypointModel":
        """Build KeyCLD with small U-Nets at half resolution, affine parts in V and g, and RATTLE."""
        from keycld.models.keycld import fast_model

        return fast_model.build(self, scene, key)

    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return the stages vision, dynamics, joint and prior; no horizon is longer than the trajectories."""
        from keycld.models.keycld import fast_stages

        return fast_stages.stages(self, scene)
