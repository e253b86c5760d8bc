"""What several presets share: the published networks, sizes, starts."""

import jax
from jaxtyping import PRNGKeyArray

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
from keycld.models import AbstractStart, CentralStart, DifferenceStart, KeyCLD
from keycld.training.presets.base import Scene
from keycld.vision import DenseEstimator, DenseRenderer, KeypointEstimator, PaperUNet, Renderer


def published_model(
    scene: Scene, key: PRNGKeyArray, kind: str, *, width: int, sigma: float, start: AbstractStart
) -> KeyCLD:
    """The networks of appendix A.4 with adaptive Dormand–Prince roll-outs, for any of `MODELS`."""
    check_sizes(scene, width, stride=1)
    keys = jax.random.split(key, 5)
    count, size = len(scene.keypoints), (scene.height, scene.width)
    dynamics = AdaptiveDynamics(_law(scene, keys[0], keys[1], kind))
    if kind == "fc":
        return KeyCLD(
            estimator=DenseEstimator(size, count, width, None, 1, key=keys[2]),
            dynamics=dynamics,
            renderer=DenseRenderer(size, count, width, None, 1, key=keys[3]),
            start=start,
        )
    return KeyCLD(
        estimator=KeypointEstimator(PaperUNet(3, count, width, key=keys[2]), None, stride=1),
        dynamics=dynamics,
        renderer=Renderer(
            PaperUNet(width, 3, width, key=keys[3]),
            0.01 * jax.random.normal(keys[4], (*size, width - count)),  # the default of the initialiser that A.4 names
            None,
            1,
            sigma,
        ),
        start=start,
    )


def _law(scene: Scene, first: PRNGKeyArray, second: PRNGKeyArray, kind: str) -> AbstractLaw:
    count = len(scene.keypoints)
    if kind == "node2":
        return SecondOrderNetwork(2 * count, scene.inputs, key=first)
    return ConstrainedLagrangian(
        mass=PointMasses.ones(count),
        potential=MLPPotential(2 * count, key=first),
        input_matrix=MLPInputMatrix(2 * count, scene.inputs, key=second) if scene.inputs else None,
        constraint=None if kind == "keycld-nc" else scene.constraint,
    )


def check_sizes(scene: Scene, width: int, stride: int) -> None:
    """Refuses pictures and widths that a U-Net's two halvings and eight groups of channels cannot divide."""
    cell = 4 * stride
    if scene.height % cell or scene.width % cell:
        raise KeycldError(
            f"this preset needs pictures whose sides are multiples of {cell}, not {scene.height} × {scene.width}: "
            "make or import them with another size."
        )
    if width % 8 or width <= len(scene.keypoints):
        raise KeycldError(f"width is a multiple of 8 above the number of keypoints, not {width}.")


def plain_start(given: int) -> AbstractStart:
    """A differenced start velocity: backward from two frames (v1), central from three (2024)."""
    if given not in (2, 3):
        raise KeycldError(f"a differenced start takes 2 or 3 given frames, not {given}.")
    return DifferenceStart() if given == 2 else CentralStart()
