"""The preset for short clips of one real motion."""

import dataclasses
import functools
from typing import TYPE_CHECKING

from keycld.models.keycld.recipes.fast import FastConfig, JointStage, VisionStage
from keycld.models.registry import register_preset
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from keycld.stages import Stage


@register_preset("clip", "keycld")
@dataclasses.dataclass(frozen=True)
class ClipConfig(FastConfig):
    """The preset of `keycld watch`: for one short clip of a real mechanism, 60 to some hundred frames.

    1. `vision`: single frames; patches around keypoints must show the same in all of them, so that keypoints are fixed
       to the parts that they follow.
    2. `dynamics`: no steps; identifies the forces that act, and their strength, from the keypoints of the recording.
    3. `joint`, left out where it has no steps.
    4. `prior`: no steps; fits once more. Then the validation score. There is no velocity prior.
    """

    velocity_prior: bool = False
    """Whether most recordings begin at rest; those of a clip begin anywhere."""
    first_frames: float = 0.0
    """Share of the clips that contain the first frames of a recording."""
    rigid: float = 2.0
    """Weight of what patches around keypoints share."""
    patch: float = 0.06
    """Width of these patches, image-plane units."""
    worth: float = 0.05
    """Share by which the cost of the fit must rise without a force for it to stay."""
    vision: VisionStage = VisionStage(steps=800, candidates=2)
    """First stage."""
    joint: JointStage = JointStage(steps=0)
    """Third stage."""

    @property
    def tried(self) -> tuple[str, ...] | None:
        """Kinds of forces that are tried: friction, and all kinds where a keypoint is not held by a pivot or a link.

        One short motion with slightly wrong keypoints can ask for a spring at a hinge that has none.
        """
        from keycld.mechanics import AbstractDisplacement, AbstractDissipationTerm, term_kinds

        hinged = {
            name
            for item in self.phi.items
            if isinstance(item, AbstractDisplacement) and item.normal is None
            for name in item.keypoints
        }
        slides = any(isinstance(item, AbstractDisplacement) and item.normal is not None for item in self.phi.items)
        if slides or hinged != set(self.phi.keypoints):
            return None
        return tuple(kind for kind, term in term_kinds().items() if issubclass(term, AbstractDissipationTerm))

    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return the stages of `fast` with the loss of patches; without `joint` if it has no steps."""
        from keycld.models.keycld.identify import Tried
        from keycld.models.keycld.prepare import fit_dynamics, identify_dynamics, measure_background
        from keycld.models.keycld.rigid_loss import RigidLoss

        vision, dynamics, joint, prior = super().stages(scene)
        loss = RigidLoss(vision.loss, self.rigid, self.patch)
        other = RigidLoss(vision.alternative, self.rigid, self.patch)
        vision = dataclasses.replace(vision, loss=loss, alternative=other, prepare=measure_background)
        identify = functools.partial(identify_dynamics, terms=self.terms, tried=Tried(self.tried, self.worth))
        dynamics = dataclasses.replace(dynamics, prepare=identify)
        refit = functools.partial(fit_dynamics, worth=self.worth if self.terms is None else None)
        prior = dataclasses.replace(prior, prepare=refit)
        return (vision, dynamics, joint, prior) if joint.steps else (vision, dynamics, prior)
