"""Mechanisms that the tracks of parts may belong to."""

import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.mechanics import candidates

TIME = np.arange(180) / 30


def end(angle, length):
    return length * np.stack([np.sin(angle), -np.cos(angle)], axis=1)


def found(*tracks, noise=0.003):
    """Return what is found for these tracks with errors of a fifth of a pixel."""
    noisy = np.stack(tracks) + noise * np.random.default_rng(0).standard_normal((len(tracks), len(TIME), 2))
    return candidates(noisy, np.ones(noisy.shape[:2], bool), np.linspace(0.02, 0.01, len(tracks)))


ANGLE = 0.9 * np.exp(-0.1 * TIME) * np.cos(4 * TIME)
SECOND = 1.4 * np.cos(6.5 * TIME + 1.0)
ALONG = np.array([np.cos(0.3), np.sin(0.3)])
SLIDE = 0.4 * np.cos(3 * TIME)


def test_a_ball_with_its_rod_and_its_shadow_is_one_pendulum():
    ball = np.array([0.1, 0.3]) + end(ANGLE, 0.6)
    best, *others = found(ball, np.array([0.1, 0.3]) + end(ANGLE, 0.3), ball + [0.08, -0.05])
    assert best.mechanism == "pendulum" and best.holds and best.freedom == 1
    assert {each.freedom for each in others} == {1, 2} and not all(each.holds for each in others)


def test_two_links_are_a_double_pendulum_and_its_joint_is_found():
    """The middles of two bars are seen; the keypoint of the first link is the joint between them."""
    elbow = end(ANGLE, 0.5)
    best = found(elbow / 2, elbow + end(SECOND, 0.2))[0]
    assert best.mechanism == "double-pendulum" and best.holds and best.freedom == 2
    away = np.linalg.norm(best.x.reshape(-1, 2, 2)[:, 0] - elbow, axis=1)
    assert np.median(away) < 0.02


@pytest.mark.parametrize("pole", [False, True])
def test_a_cart_on_a_spring_with_and_without_a_pole(pole):
    """The middle of the spring moves with the cart, and is no part of its own."""
    cart = SLIDE[:, None] * ALONG
    tracks = [cart, cart / 2 - 0.3 * ALONG, *([cart + [0.0, -0.05] + end(SECOND, 0.3)] if pole else [])]
    best = found(*tracks)[0]
    assert best.mechanism == ("cart-pole" if pole else "spring") and best.holds and best.freedom == 1 + pole


def test_two_carts_have_no_name_and_a_free_ball_no_constraint():
    carts = found(SLIDE[:, None] * ALONG, np.array([0.0, 0.5]) + np.cos(5 * TIME)[:, None] * [0.4, 0.0])[0]
    assert carts.mechanism is None and carts.freedom == 2 and len(carts.residuals) == 2
    ball = np.stack([0.4 * np.cos(3 * TIME), 0.3 * np.sin(4.1 * TIME)], axis=1)
    assert [each.freedom for each in found(ball) if each.holds] == [2]


def test_nothing_that_moves():
    with pytest.raises(KeycldError, match="no part that moves"):
        candidates(np.zeros((0, 9, 2)), np.ones((0, 9), bool), np.zeros(0))
