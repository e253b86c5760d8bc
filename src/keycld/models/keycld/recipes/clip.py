"""The preset for short clips of one real motion."""

import dataclasses
import functools
from typing import TYPE_CHECKING, ClassVar

from keycld.models.keycld.config import MODELS
from keycld.models.keycld.recipes.fast import FastConfig, JointStage, VisionStage
from keycld.models.registry import register_preset
from keycld.models.scene import Scene

if TYPE_CHECKING:
    from keycld.models.keycld.selection import Tried
    from keycld.stages import Stage


@register_preset("clip", *MODELS)
@dataclasses.dataclass(frozen=True)
class ClipConfig(FastConfig):
    """The preset of `keycld watch`: for one short clip of a real mechanism, 60 to some hundred frames.

    1. `vision`: single frames; patches around keypoints must show the same in all of them, so that keypoints are fixed
       to the parts that they follow.
    2. `dynamics`: no steps; identifies the forces that act, and their strength, from the keypoints of the recording.
    3. `joint`, left out where it has no steps.
    4. `prior`: no steps; fits once more. Then the validation score. There is no velocity prior.
    5. `final`: no steps; identifies the forces and fits the constants once more, on training and validation part.
    """

    OWN: ClassVar[bool] = False
    TOLERATED: ClassVar[float] = 0.5  # No law explains a real mechanism to the errors of its keypoints.

    velocity_prior: bool = False
    """Predictions use a prior of the initial velocity, measured on the training recordings, of which many begin at rest
    or shortly after; false: no prior.
    """
    first_frames: float = 0.0
    """Share of the clips that contain the first frames of a trajectory."""
    worth: float = 0.05
    """A force is kept only if the cost of the fit would rise by at least this share without it."""
    vision: VisionStage = VisionStage(steps=800, spread=0.5, patches=(2.0, 2.0))
    """First stage."""
    joint: JointStage = JointStage(steps=0)
    """Third stage."""

    @property
    def tried(self) -> "Tried | None":
        """Friction, and all kinds where a keypoint slides or is free; one short motion can ask for any other force.

        With keypoints that are a little wrong, a hinge would get a spring that it does not have.
        """
        from keycld.mechanics import AbstractDisplacement, AbstractDissipationTerm, term_kinds
        from keycld.models.keycld.selection import Tried

        if self.terms is not None:
            return None
        relations = [item for item in self.phi.items if isinstance(item, AbstractDisplacement)]
        hinged = {name for item in relations if item.normal is None for name in item.keypoints}
        if hinged != set(self.phi.keypoints) or any(item.normal is not None for item in relations):
            return Tried(None, self.worth, takes=True, located=True)
        friction = (kind for kind, term in term_kinds().items() if issubclass(term, AbstractDissipationTerm))
        return Tried(tuple(friction), self.worth, takes=True, located=True)

    def stages(self, scene: Scene) -> "tuple[Stage, ...]":
        """Return the stages of `fast` with a last fit; without `joint` if it has no steps."""
        from keycld.models.keycld.judge import judge_clip
        from keycld.models.keycld.prepare_dynamics import fit_again
        from keycld.models.keycld.prepare_vision import measure_background

        vision, *others = super().stages(scene)
        assert vision.alternative is not None
        # Half of the candidates pull the nearest keypoint alone to what the rendered frames lack, the others all of
        # them; of a single keypoint these hold it on what moves from the first step.
        narrow = dataclasses.replace(vision.alternative, spread=VisionStage.spread)
        wide = dataclasses.replace(vision.alternative, missing=float(self.keypoints > 1))
        judge = functools.partial(judge_clip, worst=self.vision.worst)
        vision = dataclasses.replace(vision, loss=narrow, alternative=wide, prepare=measure_background, judge=judge)
        found = [vision, *(stage for stage in others if stage.name != "joint" or stage.steps)]
        if self.model != "node2":
            again = functools.partial(fit_again, tried=self.tried)
            final = dataclasses.replace(found[-1], name="final", prepare=again, judge=None, validate=False)
            found.append(dataclasses.replace(final, with_validation=True))
        return tuple(found)
