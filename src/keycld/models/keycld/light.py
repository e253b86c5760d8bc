"""The model and the stages of the preset `fast`: light networks, RATTLE, least squares."""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from keycld.data import FrameGroups, RandomFrames
from keycld.mechanics import (
    RK4,
    AffineMLPInputMatrix,
    ConstrainedLagrangian,
    CoupledMasses,
    MechanicalDynamics,
    PointMasses,
    Rattle,
    SecondOrderNetwork,
    SumPotential,
    terms_of,
    with_kinds,
)
from keycld.models.base import AbstractModel
from keycld.models.keycld.config import KeyCLDConfig
from keycld.models.keycld.initial_state import AbstractInitialState, FittedInitialState
from keycld.models.keycld.judge import judge_dynamics, judge_trained, judge_vision
from keycld.models.keycld.losses import PredictionLoss, SmoothedLoss, TrackLoss, VisionLoss
from keycld.models.keycld.model import NODE2, AbstractKeypointModel, KeyCLD
from keycld.models.keycld.own_initial_state import OwnInitialState, OwnPrior
from keycld.models.keycld.part_light import PartLight
from keycld.models.keycld.prepare import (
    cache_keypoints,
    fit_dynamics,
    identify_dynamics,
    measure_own_prior,
    measure_part_light,
    measure_statistics,
    measure_velocity_prior,
    name_keypoints,
    sequence,
    share_constants,
)
from keycld.models.keycld.published import check_sizes, plain_initial_state
from keycld.models.keycld.velocity_prior import VelocityPrior
from keycld.models.scene import Scene
from keycld.stages import Group, Stage, muon, part, warmup_cosine
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

if TYPE_CHECKING:
    from keycld.models.keycld.recipes.fast import DynamicsStage, FastConfig

# Pixels of error that a law may have before the stage joint.
_SMALL = 0.5
# Steps of the stage vision between exchanges of names. Under wrong names constraints, once they weigh, pull keypoints
# off their parts, and soon hold as well as under the right ones: on a four-bar linkage the unevenness of the right
# order was 0.35, 0.22, 0.38, 0.52 and 0.88 of the other's at steps 350, 400, 450, 500 and 550 of 1,000.
_NAMED = 50
# Only kernels of networks are matrices that act on others: mass and input matrices are trained by Adam.
_MUON = functools.partial(muon, dense=False)


def build(config: "FastConfig", scene: Scene, key: PRNGKeyArray) -> AbstractKeypointModel:
    """Build KeyCLD or an ablation with light U-Nets at half resolution, affine parts in V and g, and RATTLE.

    Without constraints, as in KeyCLD-NC, RATTLE is the Störmer–Verlet method. NODE2 uses Runge–Kutta 4 and a
    difference for the initial velocity: it has no constrained law to fit an initial state through.

    Args:
        config: settings and the model's name.
        scene: sizes of the data.
        key: for all random weights.
    """
    check_sizes(config, scene, config.width, config.stride)
    keys, dense = jax.random.split(key, 5), config.model == "fc"
    estimator = _estimator(config, scene, keys[2], dense)
    renderer = _renderer(config, scene, keys[3], keys[4], dense)
    dim = 2 * config.keypoints
    if config.model == "node2":
        law = SecondOrderNetwork(dim, scene.inputs, key=keys[0])
        return NODE2(
            estimator=estimator,
            dynamics=MechanicalDynamics(law, RK4()),
            renderer=renderer,
            initial_state=plain_initial_state(config.context),
        )
    law = ConstrainedLagrangian(
        mass=(CoupledMasses if config.coupled_masses else PointMasses).ones(config.keypoints),
        potential=SumPotential(jnp.zeros(dim), {}),
        input_matrix=AffineMLPInputMatrix(dim, scene.inputs, config.input_width, key=keys[1]) if scene.inputs else None,
        constraint=None if config.model == "keycld-nc" else config.phi,
    )
    law = with_kinds(law, config.terms or (), key=keys[0])
    dynamics = MechanicalDynamics(law, Rattle(substeps=config.substeps))
    return KeyCLD(
        estimator=estimator,
        dynamics=dynamics,
        renderer=renderer,
        initial_state=_initial_state(config),
        velocity_prior=VelocityPrior.unknown() if config.velocity_prior and not config.own_parameters else None,
        part_light=PartLight.unknown(scene.height, scene.width) if config.own_parameters or config.discs else None,
        exchange=bool(config.exchange),
    )


def kinds(model: AbstractModel) -> tuple[str, ...] | None:
    """Return the kinds of the terms in V and R of a model; None if it has no Lagrangian."""
    return tuple(terms_of(model.law)) if isinstance(model, KeyCLD) else None


def knows_discs(model: AbstractModel) -> bool:
    """Return whether a model has found the light of discs, or may have."""
    return isinstance(model, KeyCLD) and model.part_light is not None


def _initial_state(config: "FastConfig") -> AbstractInitialState:
    # Placeholder positions, until the constants are measured on the first keypoints.
    placeholder = jnp.linspace(-0.4, 0.6, 2 * config.keypoints)
    shared = placeholder[:0] if config.model == "keycld-nc" else config.phi(placeholder)
    error = jnp.full(config.keypoints, KeyCLDConfig.ADDED["initial_state.error"])
    if config.own_parameters:
        return OwnInitialState(OwnPrior.unknown(config.keypoints, shared.shape[0]), error)
    return FittedInitialState(shared if config.shared_constants else None, error)


def _estimator(config: "FastConfig", scene: Scene, key: PRNGKeyArray, dense: bool) -> AbstractEstimator:
    count, stride, width = config.keypoints, config.stride, config.width
    standardise = Standardise(jnp.zeros((scene.height, scene.width, 3)), jnp.ones(()))
    if dense:
        return DenseEstimator((scene.height, scene.width), count, width, standardise, stride, key=key)
    looks = config.looks or 0
    return KeypointEstimator(LightUNet(3 * stride**2, count + looks, width, key=key), standardise, stride, looks)


def _renderer(
    config: "FastConfig", scene: Scene, key: PRNGKeyArray, features: PRNGKeyArray, dense: bool
) -> AbstractRenderer:
    count, stride, width = config.keypoints, config.stride, config.width
    grey = jnp.full((scene.height, scene.width, 3), 0.5)
    if dense:
        return DenseRenderer((scene.height, scene.width), count, width, grey, stride, key=key)
    shape = (scene.height // stride, scene.width // stride, width - count)
    return Renderer(
        LightUNet(width + count * (config.looks or 0), 3 * stride**2, width, key=key),
        0.1 * jax.random.normal(features, shape),
        grey,
        stride,
        config.sigma,
    )


def stages(config: "FastConfig", scene: Scene) -> tuple[Stage, ...]:
    """Return the stages vision, dynamics, joint and prior; no horizon is longer than the trajectories.

    Args:
        config: settings of each stage.
        scene: sizes of the data.
    """
    first, second, third = config.vision, config.dynamics, config.joint
    images = VisionLoss(
        heat_map=first.heat_map,
        constraint=first.constraint,
        coupling=first.coupling,
        joints=first.joints,
        # Parts that look different in each recording share nothing.
        patches=(0.0, 0.0) if config.looks else first.patches,
        patch=first.patch,
        steps=float(first.steps),
        sigma=first.sigma,
        free=bool(config.own_parameters or config.exchange),
    )
    vision = Stage(
        name="vision",
        steps=first.steps,
        sampler=RandomFrames(max(1, first.batch // 2), 2) if config.looks else RandomFrames(first.batch),
        loss=images,
        groups=(
            Group("estimator", part("estimator"), first.rate),
            Group("renderer", part("renderer"), first.rate),
        ),
        optimiser=muon,
        schedule=warmup_cosine,
        clip=1e3,
        prepare=measure_statistics,
        every=_NAMED,
        refresh=name_keypoints,
        candidates=first.candidates,
        alternative=dataclasses.replace(images, coverage=first.coverage, spread=first.spread),
        trial=first.trial,
        judge=functools.partial(judge_vision, worst=first.worst),
    )

    def clips(batch: int, horizons: tuple[int, ...], steps: int, cached: bool = False) -> FrameGroups:
        within = tuple(min(horizon, scene.frames) for horizon in horizons)
        groups = min(config.groups, max(1, min(within) // config.context))
        return FrameGroups(batch, groups, within, float(steps), cached, config.context, config.first_frames)

    joint = Stage(
        name="joint",
        steps=third.steps,
        sampler=clips(third.batch, third.horizons, third.steps),
        loss=PredictionLoss(
            track=third.track,
            constraint=third.constraint,
            heat_map=third.heat_map,
            sigma=third.sigma,
            scale=third.scale,
        ),
        groups=(
            Group("estimator", part("estimator"), third.rate),
            Group("renderer", part("renderer"), third.rate),
            Group("dynamics", _forces, third.energy_rate, _MUON),
        ),
        optimiser=muon,
        schedule=warmup_cosine,
        clip=1e3,
        every=third.fit_every,
        refresh=fit_dynamics,
    )
    if config.own_parameters:
        joint = dataclasses.replace(
            joint,
            sampler=RandomFrames(third.batch * config.groups, 2, cached=True),
            loss=SmoothedLoss(track=third.track, heat_map=third.heat_map, sigma=third.sigma, scale=third.scale),
            groups=joint.groups[:2],
            prepare=fit_dynamics,
        )
    # How far the law of an ablation is from what is seen, and where it leads the pictures, is what its scores tell.
    ablation = config.model != "keycld"
    worst = math.inf if ablation else second.worst
    if config.model == "node2":
        dynamics = _gradient_stage(second, clips)
    else:
        identify = functools.partial(identify_dynamics, terms=config.terms, tried=config.tried)
        if config.own_parameters:
            identify = sequence(functools.partial(measure_part_light, discs=config.discs is not False), identify)
        judge = functools.partial(judge_dynamics, worst=worst, small=_SMALL, tried=config.tried)
        dynamics = dataclasses.replace(
            joint, name="dynamics", steps=0, prepare=identify, every=0, refresh=None, judge=judge
        )
    refit = functools.partial(fit_dynamics, tried=config.tried)
    judge = functools.partial(
        judge_trained,
        reconstruction=math.inf if ablation else first.worst,
        law=worst,
        small=config.TOLERATED,
        tried=config.tried,
    )
    # Own parameters are told by exact places from the stage dynamics on.
    late = config.model == "keycld" and config.discs is not False and not config.own_parameters
    exact = (measure_part_light,) if late else ()
    prior = dataclasses.replace(
        joint,
        name="prior",
        steps=0,
        prepare=sequence(*exact, refit, measure_own_prior if config.own_parameters else measure_velocity_prior),
        every=0,
        refresh=None,
        judge=judge,
        validate=True,
    )
    return vision, dynamics, joint, prior


def _forces(model: AbstractKeypointModel) -> tuple[Any, ...]:
    """Return what gradients train of the dynamics: unknown numbers of the constraints are found by fits alone."""
    law = model.moving_law
    if not isinstance(law, ConstrainedLagrangian):
        return (model.dynamics,)
    return law.mass, law.potential, law.input_matrix, law.dissipation


def _gradient_stage(config: "DynamicsStage", clips: Callable[..., FrameGroups]) -> Stage:
    """Return the dynamics stage of a model without a Lagrangian: roll-outs on cached keypoints."""
    return Stage(
        name="dynamics",
        steps=config.steps,
        sampler=clips(config.batch, config.horizons, config.steps, cached=True),
        loss=TrackLoss(config.scale),
        groups=(Group("dynamics", part("dynamics"), config.rate),),
        schedule=functools.partial(warmup_cosine, final=0.1),
        clip=1.0,
        prepare=sequence(cache_keypoints, share_constants),
    )
