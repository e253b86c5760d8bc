"""The goal: keypoints of one picture, and whether they mean anything."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from keycld._errors import KeycldError
from keycld.control.base import lagrangian_of
from keycld.mechanics import Motion, State
from keycld.models.base import AbstractModel

_REACH = 0.15
"""Image-plane units (five pixels of 64) between a goal and the nearest pose that the constraints allow."""


def goal_of(model: AbstractModel, picture: UInt8[np.ndarray, "H W 3"], epsilon: float) -> Float[Array, "dim"]:
    """x* [2K], the keypoints of a goal image; with the constraints' constants that training measured, if it did.

    Args:
        model: with keypoints and a renderer.
        picture: of the pose to reach, as large as the pictures that the model was trained on.
        epsilon: ε, the error of the mean image: a pose that the model draws worse than that is none it knows.

    Raises:
        KeycldError: the picture has another size, or shows no pose that the model knows or that the constraints allow.
    """
    law = lagrangian_of(model)
    nothing = State(Motion(*jnp.zeros((2, 2 * law.masses.shape[0]))), {"constants": jnp.zeros(law.count)})
    size = jax.eval_shape(model.render, nothing).shape
    if picture.shape != size:
        raise KeycldError(
            f"the goal image has the shape {picture.shape}, but the model sees pictures of {size[0]} × {size[1]} "
            "pixels with three colours: give it at that size."
        )
    seen, drawn = _look(model, nothing, jnp.asarray(picture, jnp.float32) / 255.0)
    error = float(np.mean((np.asarray(drawn) - picture / 255.0) ** 2))
    if not error <= epsilon:
        raise KeycldError(
            "the goal image shows no pose that the model knows: drawn again from the keypoints found in it, it differs "
            f"by {error:.1e}, more than the mean image does (ε = {epsilon:.1e}); give a picture of the system from the "
            "same camera."
        )
    constants = model.constants
    return seen if constants is None else nearest_pose(model, seen, constants)


def nearest_pose(model: AbstractModel, goal: Float[Array, "dim"], constants: Float[Array, "n"]) -> Float[Array, "dim"]:
    """The pose nearest to a goal that the constraints allow.

    Args:
        model: with constraints.
        goal: x*.
        constants: Φ of the system; the goal's must be near, since they never change.

    Raises:
        KeycldError: the nearest pose with these constants is too far from the goal.
    """
    nearest = lagrangian_of(model).project_position(goal, constants, iterations=10)
    distance = float(jnp.max(jnp.abs(nearest - goal)))
    if not distance <= _REACH:
        raise KeycldError(
            f"the goal image shows a pose that the constraints keep the system from: the nearest one is {distance:.2f} "
            f"image-plane units away, more than {_REACH}; give a picture of this very system from the same camera."
        )
    return nearest


@eqx.filter_jit
def _look(model: AbstractModel, nothing: State, frame: Array) -> tuple[Array, Array]:
    seen = model.observe(frame)
    assert seen is not None  # a model with a Lagrangian has keypoints
    x = seen.keypoints.reshape(-1)
    return x, model.render(State(Motion(x, 0 * x), nothing.parameters))
