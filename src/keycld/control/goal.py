"""The goal: keypoints of one picture, and whether they show a pose that can be reached."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from keycld._errors import KeycldError
from keycld.control.requirements import require
from keycld.mechanics import ConstrainedLagrangian
from keycld.models.base import AbstractModel, HasKeypoints, HasLagrangian

_REACH = 0.15
"""Image-plane units (five pixels of 64): a goal farther than this from every allowed pose is refused."""


def goal_of(model: AbstractModel, picture: UInt8[np.ndarray, "H W 3"], epsilon: float) -> Float[Array, "dim"]:
    """Return x* [2K], the keypoints of a goal image; on the constraints where training measured their constants.

    Args:
        model: with keypoints and a Lagrangian.
        picture: of the pose to reach, as large as the pictures that the model was trained on.
        epsilon: ε, the error of the mean image: a pose that the model renders worse than that is unknown to it.

    Raises:
        KeycldError: the picture has another size, or shows no pose that the model knows or that the constraints allow.
    """
    lagrangian, keypoint_model = require(model, HasLagrangian), require(model, HasKeypoints)
    pose = jnp.zeros((lagrangian.law.masses.shape[0], 2))
    size = jax.eval_shape(lambda pose: model.render(keypoint_model.at_rest(pose)), pose).shape
    if picture.shape != size:
        raise KeycldError(
            f"the goal image has the shape {picture.shape}, but the model takes pictures of {size[0]} × {size[1]} "
            "pixels with three colours: give it at that size."
        )
    frame = jnp.asarray(picture, jnp.float32) / 255.0
    keypoints = eqx.filter_jit(keypoint_model.observe)(frame).keypoints
    rendered = eqx.filter_jit(model.render)(keypoint_model.at_rest(keypoints))
    error = float(np.mean((np.asarray(rendered) - picture / 255.0) ** 2))
    if not error <= epsilon:
        raise KeycldError(
            "the goal image shows no pose that the model knows: rendered again from the keypoints found in it, it "
            f"differs by {error:.1e}, more than the mean image does (ε = {epsilon:.1e}); give a picture of the system "
            "from the same camera."
        )
    goal, constants = keypoints.reshape(-1), lagrangian.constants
    return goal if constants is None else nearest_pose(lagrangian, goal, constants)


@eqx.filter_jit
def _projected(law: ConstrainedLagrangian, goal: Array, constants: Array) -> Array:
    return law.project_position(goal, constants, iterations=10)


def nearest_pose(
    lagrangian: HasLagrangian, goal: Float[Array, "dim"], constants: Float[Array, "n"]
) -> Float[Array, "dim"]:
    """Return the pose nearest to a goal that the constraints allow, [2K].

    Args:
        lagrangian: the model.
        goal: x* [2K], image-plane units.
        constants: Φ [n] of the system; the goal's must be near, since they never change.

    Raises:
        KeycldError: the nearest pose with these constants is too far from the goal.
    """
    nearest = _projected(lagrangian.law, goal, constants)
    distance = float(jnp.max(jnp.abs(nearest - goal)))
    if not distance <= _REACH:
        raise KeycldError(
            f"the goal image shows a pose that the constraints do not allow: the nearest one is {distance:.2f} "
            f"image-plane units away, more than {_REACH}; give a picture of the same system from the same camera."
        )
    return nearest
