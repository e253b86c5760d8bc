"""The stages of the preset `fast`: vision, dynamics, joint and prior."""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from keycld.data import FrameGroups, RandomFrames, Resident
from keycld.mechanics import ConstrainedLagrangian
from keycld.models.keycld.judge import judge_dynamics, judge_trained, judge_vision
from keycld.models.keycld.losses import PredictionLoss, SmoothedLoss, TrackLoss, VisionLoss
from keycld.models.keycld.model import AbstractKeypointModel
from keycld.models.keycld.observe import FITTED
from keycld.models.keycld.prepare_dynamics import cache_keypoints, fit_dynamics, identify_dynamics, share_constants
from keycld.models.keycld.prepare_priors import measure_own_prior, measure_velocity_prior
from keycld.models.keycld.prepare_vision import measure_part_light, measure_statistics, name_keypoints
from keycld.models.scene import Scene
from keycld.stages import Group, Stage, muon, part, warmup_cosine

if TYPE_CHECKING:
    from keycld.models.keycld.recipes.fast import FastConfig

# Pixels of error that a law may have before the stage joint.
_SMALL = 0.5
# Steps of the stage vision between exchanges of names. Under wrong names constraints, once they weigh, pull keypoints
# off their parts, and soon hold as well as under the right ones: on a four-bar linkage the unevenness of the right
# order was 0.35, 0.22, 0.38, 0.52 and 0.88 of the other's at steps 350, 400, 450, 500 and 550 of 1,000.
_NAMED = 50
# Only kernels of networks are matrices that act on others: mass and input matrices are trained by Adam.
_MUON = functools.partial(muon, dense=False)


def stages(config: "FastConfig", scene: Scene, observed: int = FITTED) -> tuple[Stage, ...]:
    """Return the stages vision, dynamics, joint and prior; no horizon is longer than the trajectories.

    Args:
        config: settings of each stage.
        scene: sizes of the data.
        observed: about how many recordings the last least-squares fit observes.
    """
    joint = _joint(config, scene)
    return _vision(config), _dynamics(config, scene, joint), joint, _prior(config, joint, observed)


def sequence(*steps: Callable) -> Callable[[Any, Resident], tuple[Any, Resident]]:
    """Return several preparations as one."""

    def prepare(model: Any, data: Resident) -> tuple[Any, Resident]:
        for step in steps:
            model, data = step(model, data)
        return model, data

    return prepare


def _vision(config: "FastConfig") -> Stage:
    settings = config.vision
    loss = VisionLoss(
        heat_map=settings.heat_map,
        constraint=settings.constraint,
        coupling=settings.coupling,
        joints=settings.joints,
        # Parts that look different in each recording share nothing.
        patches=(0.0, 0.0) if config.looks else settings.patches,
        patch=settings.patch,
        steps=float(settings.steps),
        sigma=settings.sigma,
        free=bool(config.own_parameters or config.exchange),
    )
    return Stage(
        name="vision",
        steps=settings.steps,
        sampler=RandomFrames(max(1, settings.batch // 2), 2) if config.looks else RandomFrames(settings.batch),
        loss=loss,
        groups=_networks(settings.rate),
        optimiser=muon,
        schedule=warmup_cosine,
        clip=1e3,
        prepare=measure_statistics,
        every=_NAMED,
        refresh=name_keypoints,
        candidates=settings.candidates,
        alternative=dataclasses.replace(loss, coverage=settings.coverage, spread=settings.spread),
        trial=settings.trial,
        judge=functools.partial(judge_vision, worst=settings.worst),
    )


def _dynamics(config: "FastConfig", scene: Scene, joint: Stage) -> Stage:
    """Return the stage dynamics: no steps, or for a model without a Lagrangian roll-outs on cached keypoints."""
    settings = config.dynamics
    if config.model == "node2":
        return Stage(
            name="dynamics",
            steps=settings.steps,
            sampler=_clips(config, scene, settings.batch, settings.horizons, settings.steps, cached=True),
            loss=TrackLoss(settings.scale),
            groups=(Group("dynamics", part("dynamics"), settings.rate),),
            schedule=functools.partial(warmup_cosine, final=0.1),
            clip=1.0,
            prepare=sequence(cache_keypoints, share_constants),
        )
    identify = functools.partial(identify_dynamics, terms=config.terms, tried=config.tried)
    if config.own_parameters:
        identify = sequence(functools.partial(measure_part_light, discs=config.discs is not False), identify)
    judge = functools.partial(judge_dynamics, worst=_worst_law(config), small=_SMALL, tried=config.tried)
    return dataclasses.replace(joint, name="dynamics", steps=0, prepare=identify, every=0, refresh=None, judge=judge)


def _joint(config: "FastConfig", scene: Scene) -> Stage:
    settings = config.joint
    weights = {"track": settings.track, "heat_map": settings.heat_map, "sigma": settings.sigma, "scale": settings.scale}
    joint = Stage(
        name="joint",
        steps=settings.steps,
        sampler=_clips(config, scene, settings.batch, settings.horizons, settings.steps),
        loss=PredictionLoss(constraint=settings.constraint, **weights),
        groups=(*_networks(settings.rate), Group("dynamics", _forces, settings.energy_rate, _MUON)),
        optimiser=muon,
        schedule=warmup_cosine,
        clip=1e3,
        every=settings.fit_every,
        refresh=fit_dynamics,
    )
    if not config.own_parameters:
        return joint
    return dataclasses.replace(
        joint,
        sampler=RandomFrames(settings.batch * config.groups, 2, cached=True),
        loss=SmoothedLoss(**weights),
        groups=_networks(settings.rate),
        prepare=fit_dynamics,
    )


def _prior(config: "FastConfig", joint: Stage, observed: int) -> Stage:
    ablation = config.model != "keycld"
    # Own parameters are told by exact places from the stage dynamics on.
    late = not ablation and config.discs is not False and not config.own_parameters
    refit = functools.partial(fit_dynamics, trajectories=observed, tried=config.tried)
    measure = measure_own_prior if config.own_parameters else measure_velocity_prior
    judge = functools.partial(
        judge_trained,
        reconstruction=math.inf if ablation else config.vision.worst,
        law=_worst_law(config),
        small=config.TOLERATED,
        tried=config.tried,
    )
    return dataclasses.replace(
        joint,
        name="prior",
        steps=0,
        prepare=sequence(measure_part_light, refit, measure) if late else sequence(refit, measure),
        every=0,
        refresh=None,
        judge=judge,
        validate=True,
    )


def _networks(rate: float) -> tuple[Group, Group]:
    return Group("estimator", part("estimator"), rate), Group("renderer", part("renderer"), rate)


def _clips(
    config: "FastConfig", scene: Scene, batch: int, horizons: tuple[int, ...], steps: int, cached: bool = False
) -> FrameGroups:
    within = tuple(min(horizon, scene.frames) for horizon in horizons)
    groups = min(config.groups, max(1, min(within) // config.context))
    return FrameGroups(batch, groups, within, float(steps), cached, config.context, config.first_frames)


def _worst_law(config: "FastConfig") -> float:
    """Return `dynamics.worst`; for an ablation any law passes: its scores tell how far it is from what is seen."""
    return config.dynamics.worst if config.model == "keycld" else math.inf


def _forces(model: AbstractKeypointModel) -> tuple[Any, ...]:
    """Return what gradients train of the dynamics: unknown numbers of the constraints are found by fits alone."""
    law = model.moving_law
    if not isinstance(law, ConstrainedLagrangian):
        return (model.dynamics,)
    return law.mass, law.potential, law.input_matrix, law.dissipation
