"""What patches share fixes keypoints to the parts that they follow."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.data import Trajectories, resident
from keycld.models import Scene, config_for
from keycld.models.keycld.patches import shared_patches
from keycld.models.keycld.prepare_vision import measure_background

SIZE = 32
PENDULUM = 'keypoints = ["ball"]\n\n[[constraint]]\nkind = "distance_to_point"\nkeypoint = "ball"\npoint = "unknown"\n'


def place(frames=24):
    """Positions of an orange ball that swings around (0.1, 0.3) with the radius 0.7."""
    angle = 1.2 * np.cos(np.linspace(0, 2 * np.pi, frames))
    return np.stack([0.1 + 0.7 * np.sin(angle), 0.3 - 0.7 * np.cos(angle)], -1)


def pictures(x):
    """The ball, and a brighter grey rod that ends at it."""
    axis = np.linspace(-1, 1, SIZE)
    grid = np.stack(np.meshgrid(axis, axis[::-1]), -1)
    found = []
    for ball in x:
        far = np.linalg.norm(grid - ball, axis=-1)
        along = ball - (0.1, 0.3)
        share = np.clip(((grid - (0.1, 0.3)) @ along) / (along @ along), 0, 1)[..., None]
        rod = np.clip(1.5 - np.linalg.norm(grid - (0.1, 0.3) - share * along, axis=-1) * 15, 0, 1)[..., None]
        disc = np.clip(2.5 - far * 15, 0, 1)[..., None]
        picture = 60 + rod * np.array([110.0, 110, 100])
        found.append((1 - disc) * picture + disc * np.array([220.0, 110, 30]))
    return np.round(np.stack(found)).astype(np.uint8)


@pytest.fixture(scope="module")
def seen():
    """The shared energy of patches around given keypoints of the swinging ball."""
    x = place()
    image = pictures(x)[None]
    attributes = {"dt": 0.04, "system": "swing"}
    data = resident(Trajectories(np.arange(24) * 0.04, np.zeros((1, 0), np.float32), image, attributes=attributes))
    config = config_for("keycld", "clip", width=8, constraints=PENDULUM)
    model = config.build(Scene(SIZE, SIZE, 0, 24, 0.04, 1), jax.random.key(0))
    model, _ = measure_background(model, data)
    frames = jnp.asarray(image[0] / 255.0, jnp.float32)
    shared = eqx.filter_jit(lambda keypoints: shared_patches(model, keypoints[:, None], frames, 0.1))
    return lambda keypoints: float(shared(jnp.asarray(keypoints, jnp.float32)))


@pytest.mark.parametrize(
    "wrong",
    [
        lambda x: x + np.array([0.1, 0.0]),
        lambda x: x + np.array([0.0, -0.1]),
        lambda x: (0.1, 0.3) + 0.8 * (x - (0.1, 0.3)),
        lambda x: (0.1, 0.3) + 1.2 * (x - (0.1, 0.3)),
        lambda x: np.roll(x, 3, axis=0),
        lambda x: np.broadcast_to(x[:1], x.shape),
    ],
    ids=["beside", "below", "inside", "outside", "late", "still"],
)
def test_patches_share_most_where_keypoints_follow_the_ball(seen, wrong):
    """Circles around other centres or of other radii would render the same frames."""
    assert seen(place()) > seen(wrong(place())) + 0.1


def test_the_gradient_leads_from_a_wrong_circle_to_the_ball(seen):
    shift = np.array([0.03, -0.02])
    values = [seen(place() + share * shift) for share in (0.0, 0.5, 1.0)]
    assert values[0] > values[1] > values[2]


def test_the_background_of_a_clip_is_its_median(seen):
    """The place where the ball turns round is the background's colour, not a mixture."""
    x = place(25)
    data = resident(
        Trajectories(np.arange(25) * 0.04, np.zeros((1, 0), np.float32), pictures(x)[None],
                     attributes={"dt": 0.04, "system": "swing"})
    )  # fmt: skip
    config = config_for("keycld", "clip", width=8, constraints=PENDULUM)
    model, _ = measure_background(config.build(Scene(SIZE, SIZE, 0, 25, 0.04, 1), jax.random.key(0)), data)
    assert np.abs(np.asarray(model.renderer.background)[2:12, :4] - 60 / 255).max() < 1e-3
