"""The model of the preset `fast`: small U-Nets at half resolution, affine parts in V and g, and RATTLE."""

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

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
    with_kinds,
)
from keycld.models.keycld.config import KeyCLDConfig
from keycld.models.keycld.initial_state import AbstractInitialState, FittedInitialState
from keycld.models.keycld.model import NODE2, AbstractKeypointModel, KeyCLD
from keycld.models.keycld.own_initial_state import OwnInitialState, OwnPrior
from keycld.models.keycld.part_light import PartLight
from keycld.models.keycld.published import check_sizes, plain_initial_state
from keycld.models.keycld.velocity_prior import VelocityPrior
from keycld.models.scene import Scene
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
    from keycld.models.keycld.recipes.fast import FastConfig


def build(config: "FastConfig", scene: Scene, key: PRNGKeyArray) -> AbstractKeypointModel:
    """Build KeyCLD or an ablation with small U-Nets at half resolution, affine parts in V and g, and RATTLE.

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
