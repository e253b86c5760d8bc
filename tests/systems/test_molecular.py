"""Molecular dynamics keeps what it should, and its forces are those of the potential."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld import KeycldError
from keycld.systems import get
from keycld.systems.molecular import simulation

LIQUID = {"particles": 16, "density": 0.77, "temperature": 0.5}


@pytest.fixture(scope="module")
def liquid():
    """Windows [6, 5, 20, 64] of six short simulations."""
    with jax.enable_x64(True):
        lengths = simulation.Lengths(20.0, 5.0, 10.0)
        return simulation.simulate(np.arange(6), **LIQUID, lengths=lengths, windows=5, frames=20)


def energies(state):
    system = get("md/lj_16")
    return system.all_conserved(state.reshape(-1, *state.shape[-2:]), {}).reshape(state.shape[:3])


def test_molecular_dynamics_keeps_energy_and_momentum(liquid):
    energy = energies(liquid)
    assert np.abs(energy - energy.mean(axis=(1, 2), keepdims=True)).max() < 1e-3 * np.abs(energy).mean()
    momentum = liquid[..., 32:].reshape(*liquid.shape[:3], 16, 2).sum(axis=-2)
    assert np.abs(momentum).max() < 1e-10


def test_molecular_dynamics_has_its_temperature(liquid):
    kinetic = 0.5 * np.sum(liquid[..., 32:] ** 2, axis=-1)
    # 30 degrees of freedom: the net momentum is zero.
    assert kinetic.mean() / 15 == pytest.approx(0.5, rel=0.15)


def test_particles_stay_in_the_box_and_apart(liquid):
    place = liquid[..., :32].reshape(-1, 16, 2)
    box = np.sqrt(16 / 0.77)
    assert np.abs(place).max() <= box / 2
    gap = place[:, :, None] - place[:, None]
    gap -= box * np.round(gap / box)
    assert np.sqrt(np.sum(gap**2, axis=-1))[:, ~np.eye(16, dtype=bool)].min() > 0.8


def test_frames_of_a_window_follow_from_the_first(liquid):
    """Taylor's series to second order, over 0.01 τ, with the derivative's forces."""
    system = get("md/lj_16")
    state = liquid[0, 0]
    derivative = system.derivatives(state[None], {})[0]
    later = state[:-1, :32] + 0.01 * derivative[:-1, :32] + 0.5e-4 * derivative[:-1, 32:]
    moved = (state[1:, :32] - later + np.sqrt(16 / 0.77) / 2) % np.sqrt(16 / 0.77) - np.sqrt(16 / 0.77) / 2
    assert np.abs(moved).max() < 5e-4


def test_forces_are_the_slope_of_the_truncated_potential():
    box = 4.5
    x = np.random.RandomState(1).uniform(-2, 2, (2, 5, 1))
    with jax.enable_x64(True):
        force = simulation.forces(jnp.asarray(x), box)
        slope = jax.grad(lambda x: simulation.potential_energy(x, box)[0])(jnp.asarray(x))
        # A pair at three distances; 2.7 along one axis would be 1.8 to the nearest image.
        gaps = [(1.2, 0.0), (1.8, 1.8), (2.2499, 0.0)]
        pairs = jnp.asarray(np.array([np.zeros((3, 2)), gaps]).transpose(2, 0, 1))
        energy, beyond, edge = np.asarray(simulation.potential_energy(pairs, box))
    np.testing.assert_allclose(force, -slope, rtol=1e-9, atol=1e-9)
    assert energy == pytest.approx(4 * (1.2**-12 - 1.2**-6)) and beyond == 0.0
    # Not shifted: the energy jumps where the potential is cut.
    assert edge == pytest.approx(4 * (2.2499**-12 - 2.2499**-6)) and edge < -0.02


def test_a_simulation_does_not_depend_on_its_neighbours(liquid):
    with jax.enable_x64(True):
        lengths = simulation.Lengths(20.0, 5.0, 10.0)
        again = simulation.simulate(np.arange(2, 8), **LIQUID, lengths=lengths, windows=5, frames=20)
    np.testing.assert_array_equal(again[:4], liquid[2:])


def test_windows_must_fit():
    with pytest.raises(KeycldError, match="do not fit into 10 τ"):
        simulation.simulate(np.arange(2), **LIQUID, lengths=simulation.Lengths(1, 1, 10), windows=5, frames=250)
