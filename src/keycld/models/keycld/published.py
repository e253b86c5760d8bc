"""The networks of the papers, for the presets `paper` and `journal`."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Key, PRNGKeyArray

from keycld._errors import KeycldError
from keycld.mechanics import (
    AbstractLaw,
    AdaptiveDynamics,
    ConstrainedLagrangian,
    MLPInputMatrix,
    MLPPotential,
    PointMasses,
    SecondOrderNetwork,
)
from keycld.models.keycld.config import KeyCLDConfig
from keycld.models.keycld.initial_state import AbstractInitialState, CentralInitialState, DifferenceInitialState
from keycld.models.keycld.model import NODE2, AbstractKeypointModel, KeyCLD
from keycld.models.keycld.published_config import PublishedConfig
from keycld.models.scene import Scene
from keycld.vision import (
    AbstractEstimator,
    AbstractRenderer,
    DenseEstimator,
    DenseRenderer,
    KeypointEstimator,
    PaperUNet,
    Renderer,
)

M = TypeVar("M", bound=eqx.Module)


def build(config: PublishedConfig, scene: Scene, key: PRNGKeyArray) -> AbstractKeypointModel:
    """Build the networks of appendix A.4 with adaptive Dormand–Prince roll-outs, for any model of the family."""
    width = config.width
    check_sizes(config, scene, width, stride=1)
    keys = jax.random.split(key, 5)
    estimator, renderer = _vision(config, scene, keys[2:])
    initial, count = plain_initial_state(config.context), config.keypoints

    def moved_by(law: AbstractLaw) -> AdaptiveDynamics:
        return AdaptiveDynamics(law, rtol=config.tolerance, atol=config.tolerance, pull_back=config.pull_back)

    if config.model == "node2":
        law = SecondOrderNetwork(2 * count, scene.inputs, 2 * width, key=keys[0])
        return NODE2(estimator=estimator, dynamics=moved_by(law), renderer=renderer, initial_state=initial)
    masses = (
        PointMasses.ones(count) if config.unit_masses else PointMasses.near_zero(count, key=jax.random.fold_in(key, 5))
    )
    phi = config.phi.distances() if config.distances else config.phi
    law = ConstrainedLagrangian(
        mass=masses,
        potential=MLPPotential(2 * count, width, key=keys[0]),
        input_matrix=MLPInputMatrix(2 * count, scene.inputs, width, key=keys[1]) if scene.inputs else None,
        constraint=None if config.model == "keycld-nc" else phi,
    )
    return KeyCLD(estimator=estimator, dynamics=moved_by(law), renderer=renderer, initial_state=initial)


def _vision(config: PublishedConfig, scene: Scene, keys: Key[Array, "3"]) -> tuple[AbstractEstimator, AbstractRenderer]:
    count, width, size = config.keypoints, config.width, (scene.height, scene.width)
    if config.model == "fc":
        estimator = DenseEstimator(size, count, width, None, 1, key=keys[0])
        renderer = DenseRenderer(size, count, width, None, 1, key=keys[1])
        return _as_in_flax(estimator, keys[0]), _as_in_flax(renderer, keys[1])
    # The initialiser that A.4 names for the constant feature maps has a standard deviation of 0.01 by default.
    features = 0.01 * jax.random.normal(keys[2], (*size, width - count))
    network = PaperUNet(width, 3, width, key=keys[1])
    return (
        KeypointEstimator(PaperUNet(3, count, width, key=keys[0]), None, stride=1),
        Renderer(network, features, None, 1, config.sigma),
    )


def _as_in_flax(module: M, key: PRNGKeyArray) -> M:
    """Return the module with its dense layers initialised as in Flax: LeCun-normal kernels and zero biases."""

    def dense(tree: M) -> list[eqx.nn.Linear]:
        found = jax.tree.leaves(tree, is_leaf=lambda leaf: isinstance(leaf, eqx.nn.Linear))
        return [leaf for leaf in found if isinstance(leaf, eqx.nn.Linear)]

    kernel = jax.nn.initializers.lecun_normal(in_axis=1, out_axis=0)
    layers = dense(module)
    keys = jax.random.split(jax.random.fold_in(key, 1), len(layers))
    new = [
        eqx.tree_at(lambda d: (d.weight, d.bias), layer, (kernel(k, layer.weight.shape), jnp.zeros(layer.out_features)))
        for layer, k in zip(layers, keys, strict=True)
    ]
    return eqx.tree_at(dense, module, new)


def check_sizes(config: KeyCLDConfig, scene: Scene, width: int, stride: int) -> None:
    """Refuse frames and widths that do not fit a U-Net, which halves the frame twice and has eight channel groups.

    Args:
        config: its number of keypoints must be below `width`.
        scene: height and width must be multiples of 4 `stride`.
        width: channels; must be a multiple of 8.
        stride: pixels of a heat-map cell.

    Raises:
        KeycldError: names the size and what fits.
    """
    cell = 4 * stride
    if scene.height % cell or scene.width % cell:
        raise KeycldError(
            f"this preset needs frames whose sides are multiples of {cell}, not {scene.height} × {scene.width}: "
            "make or import them in another size."
        )
    if width % 8 or width <= config.keypoints:
        raise KeycldError(
            f"width is a multiple of 8 above the number of keypoints, {config.keypoints}, not {width}: set another one."
        )


def plain_initial_state(given: int) -> AbstractInitialState:
    """Return the initial state with a velocity by differences: backward from two frames (v1), central from three.

    Raises:
        KeycldError: another number of given frames.
    """
    if given not in (2, 3):
        raise KeycldError(f"a velocity by differences needs 2 or 3 given frames, not {given}.")
    return DifferenceInitialState() if given == 2 else CentralInitialState()
