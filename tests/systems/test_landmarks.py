"""True keypoint positions lie where the pictures show them, and the suggested constraints hold for them."""

import numpy as np
import pytest
from segmentation import masks

from keycld.systems import AbstractMujocoSystem, Conditions, Task, get, names, run_in_processes

SIZE = 256
# A picture of another size measures the same places with the centres of its own outermost pixels.
OWN_UNITS = (64 / 63) / (SIZE / (SIZE - 1))


def _pixels(mask):
    axis = np.linspace(-1.0, 1.0, SIZE)
    row, column = np.nonzero(mask)
    return OWN_UNITS * np.stack([axis[column], -axis[row]], axis=-1)


def _rendered(name, count):
    system = get(name)
    random = np.random.RandomState(0)
    positions = np.stack([system.positions(random, 0.5) for _ in range(count)])
    [(_, found)] = run_in_processes([Task(masks, (name, positions, SIZE))])
    states = np.concatenate([positions, np.zeros_like(positions)], axis=-1)
    return system.landmarks(states), found


def _radius(name, metres):
    system = get(name)
    origin = np.array([0.0, system.camera_height])
    return system.to_image_plane(origin + np.array([metres, 0.0]))[0]


def _check_link(pixels, start, end, radius):
    """The link's pixels lie around the line from `start` to `end` and reach one radius beyond `end`."""
    along = (end - start) / np.linalg.norm(end - start)
    across = np.array([-along[1], along[0]])
    assert abs(np.mean((pixels - start) @ across)) < 0.01
    assert np.max((pixels - start) @ along) == pytest.approx(np.linalg.norm(end - start) + radius, abs=0.015)


def test_the_pendulums_bob():
    for landmarks, found in zip(*_rendered("pendulum", 12), strict=True):
        np.testing.assert_allclose(_pixels(found["mass"]).mean(axis=0), landmarks[0], atol=0.004)


def test_the_cartpoles_cart_and_tip():
    for (cart, tip), found in zip(*_rendered("cartpole", 12), strict=True):
        assert _pixels(found["cart"]).mean(axis=0)[0] == pytest.approx(cart[0], abs=0.01)
        _check_link(_pixels(found["pole"]), cart, tip, _radius("cartpole", 0.09))


def test_the_acrobots_elbow_and_tip():
    for (elbow, tip), found in zip(*_rendered("acrobot", 12), strict=True):
        _check_link(_pixels(found["lower_arm"]), elbow, tip, _radius("acrobot", 0.099))
        arm = _pixels(found["upper_arm"])
        assert abs(np.mean(arm @ np.array([-elbow[1], elbow[0]])) / np.linalg.norm(elbow)) < 0.01


@pytest.mark.parametrize("name", names(AbstractMujocoSystem))
def test_suggested_constraints_are_constant_along_true_motion(name):
    import jax

    system = get(name)
    assert system.constraints.keypoints == system.keypoints
    for start in ("rest", "random"):
        run = system.record(np.random.RandomState(2), 50, Conditions(initial_state=start))
        x = system.landmarks(run.state).reshape(50, -1).astype(np.float32)
        values = np.asarray(jax.vmap(lambda x: system.constraints(x, {}))(x))
        assert values.shape == (50, system.constraints.count)
        assert np.ptp(values, axis=0).max() < 1e-5
        assert np.ptp(x, axis=0).max() > 0.01
