"""SyMetric on transformations whose answer is known."""

import numpy as np
import pytest

from keycld import KeycldError
from keycld.data import DataSet, Trajectories, write
from keycld.evaluation.latent_regression import score_symetric, symetric
from swing import Still


@pytest.fixture(scope="module")
def truth():
    """Five trajectories of two harmonic oscillators of their own frequencies: (q₁, q₂, p₁, p₂)."""
    random = np.random.default_rng(0)
    amplitude, phase = random.uniform(0.5, 1.5, (5, 1, 2)), random.uniform(0, 2 * np.pi, (5, 1, 2))
    angle = phase + np.arange(60)[None, :, None] * np.array([0.31, 0.47])
    return np.concatenate([amplitude * np.cos(angle), amplitude * np.sin(angle)], axis=2)


def test_the_state_itself_and_canonical_maps_pass(truth):
    """A rotation in the (q, p) plane, and p + ∂S/∂q for a cubic S: both are canonical."""
    q, p = truth[..., :2], truth[..., 2:]
    turned = np.concatenate([0.6 * q + 0.8 * p, -0.8 * q + 0.6 * p], axis=2)
    kicked = np.concatenate([q, p + q**2], axis=2)
    for latent in (truth, turned):
        found = symetric(truth, latent)
        assert found.passed and found.degree == 1 and found.r2 > 0.99 and found.asymmetry < 0.01
    found = symetric(truth, kicked)
    assert found.passed and found.degree == 2 and found.asymmetry < 0.05


def test_a_map_that_mixes_positions_alone_fails(truth):
    """Everything is known, but (q₁ + q₂, q₂, p₁, p₂) would need p₂ − p₁ as the second momentum."""
    q, p = truth[..., :2], truth[..., 2:]
    mixed = np.concatenate([q[..., :1] + q[..., 1:], q[..., 1:], p], axis=2)
    found = symetric(truth, mixed)
    assert not found.passed and found.r2 > 0.99 and found.asymmetry > 0.05


def test_noise_fails(truth):
    noise = np.random.default_rng(1).normal(size=(*truth.shape[:2], 2))
    found = symetric(truth, noise)
    assert not found.passed and found.r2 < 0.5


def test_only_informative_pairs_count(truth):
    """Of (q₁, q₂, 0, p₁, p₂, 0) the first pair is used for an informative q₁ alone; none informative means all."""
    nothing = np.zeros((*truth.shape[:2], 1))
    latent = np.concatenate([truth[..., :2], nothing, truth[..., 2:], nothing], axis=2)
    found = symetric(truth[..., [0, 2]], latent, np.array([True, *[False] * 5]))
    assert found.passed and found.informative == 2
    assert symetric(truth, latent).informative == 6
    assert symetric(truth, nothing) == (False, 0.0, 1000.0, 0, 1)


def test_data_without_true_states_are_refused(tmp_path):
    image = np.zeros((5, 60, 8, 8, 3), np.uint8)
    attributes = {"system": "disc", "dt": 0.1, "input_names": ()}
    recordings = Trajectories(np.arange(60) * 0.1, np.zeros((5, 0), np.float32), image, attributes=attributes)
    for name in ("train", "validation", "test"):
        write(tmp_path / f"{name}.h5", recordings)
    with pytest.raises(KeycldError, match="has no '/state'"):
        score_symetric(Still(), DataSet(tmp_path, None))
