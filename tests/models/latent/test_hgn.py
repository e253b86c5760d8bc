"""HGN: a Hamiltonian system in the latent vector of an autoencoder."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.models import Scene, config_for
from keycld.models.base import HasEnergies, HasInputMatrix, HasKeypoints, Reversible

TINY = {"channels": 4, "hidden": 16, "depth": 2, "latent": 6}
DT = jnp.array(0.05)


def scene(inputs=0, frames=20):
    return Scene(16, 16, inputs, frames, 0.05, 3)


def built(key, inputs=0, **settings):
    return config_for("hgn", "released", **TINY, **settings).build(scene(inputs), key)


def with_forces(key, **settings):
    """A random HGN whose forces are of the order of one."""
    model = built(key, **settings)
    return eqx.tree_at(lambda m: m.dynamics, model, jax.tree.map(lambda w: 2.0 * w, model.dynamics))


@pytest.fixture
def lively(getkey):
    return with_forces(getkey())


@pytest.fixture
def state(lively, getkey):
    return lively.state(jax.random.normal(getkey(), (6,)))


def energies(model, states):
    return jax.vmap(lambda s: model.kinetic_energy(s) + model.potential_energy(s))(states)


def test_it_has_the_number_of_weights_of_the_benchmark():
    model = eqx.filter_eval_shape(
        config_for("hgn", "released").build, Scene(32, 32, 0, 256, 0.05, 100), jax.random.key(0)
    )
    assert sum(leaf.size for leaf in jax.tree.leaves(model)) == 882_561


def test_leapfrog_keeps_the_energy_to_second_order(getkey):
    """Halving the interval divides the largest deviation by four, and it does not grow with time."""
    key = getkey()
    lively = with_forces(key)
    state = lively.state(jax.random.normal(getkey(), (6,)))

    def deviations(interval):
        model = with_forces(key, interval=interval)
        found = energies(model, model.rollout(state, DT, jnp.zeros(0), round(12.5 / interval)))
        return np.abs(np.asarray(found) - float(found[0]))

    coarse, fine = deviations(0.125), deviations(0.0625)
    assert 3.0 < coarse.max() / fine.max() < 5.0
    assert coarse[50:].max() < 3 * coarse[:50].max()
    kinetic = jax.vmap(lively.kinetic_energy)(lively.rollout(state, DT, jnp.zeros(0), 100))
    assert coarse.max() < 0.05 * float(kinetic.max() - kinetic.min())


def test_kinetic_energy_is_zero_at_rest(lively, state):
    """Whatever constant the network of T has learned."""
    rest = eqx.tree_at(lambda s: s.coordinates.p, state, 0.0 * state.coordinates.p)
    last = lively.hamiltonian.kinetic.network.layers[-1].bias
    shifted = eqx.tree_at(lambda m: m.hamiltonian.kinetic.network.layers[-1].bias, lively, last - 7.0)
    assert float(shifted.kinetic_energy(rest)) == 0.0
    np.testing.assert_allclose(shifted.kinetic_energy(state), lively.kinetic_energy(state), rtol=1e-4, atol=1e-5)


def test_backward_is_the_inverse_of_forward(lively, state):
    there = lively.rollout(state, DT, jnp.zeros(0), 30)
    end = jax.tree.map(lambda path: path[-1], there)
    back = lively.rollout(end, -DT, jnp.zeros(0), 30)
    assert float(jnp.abs(there.coordinates.q[-1] - state.coordinates.q).max()) > 0.1
    for one, other in zip(jax.tree.leaves(there), jax.tree.leaves(back), strict=True):
        np.testing.assert_allclose(other[::-1], one, atol=1e-4)


def test_a_frame_is_an_eighth_of_a_time_unit_whatever_the_datas_dt(lively, state):
    paths = [lively.rollout(state, jnp.array(dt), jnp.zeros(0), 5).coordinates.q for dt in (0.05, 0.1)]
    np.testing.assert_array_equal(*paths)
    q, p = state.coordinates
    middle = p - 0.0625 * jax.grad(lively.hamiltonian.potential)(q)
    np.testing.assert_allclose(paths[0][1], q + 0.125 * jax.grad(lively.hamiltonian.kinetic)(middle), rtol=1e-5)


def test_the_picture_shows_positions_not_momenta(lively, state):
    pushed = eqx.tree_at(lambda s: s.coordinates.p, state, state.coordinates.p + 1.0)
    np.testing.assert_array_equal(lively.render(pushed), lively.render(state))


def test_prediction_takes_the_posteriors_mean_at_the_last_given_frame(lively, getkey):
    frames = jax.random.uniform(getkey(), (7, 16, 16, 3))
    found = lively.predict(frames, DT, jnp.zeros(0), 12)
    mean = lively.posterior(frames[:5]).mean
    np.testing.assert_allclose(found.states.coordinates.q[4], mean[:3], rtol=1e-6)
    np.testing.assert_allclose(found.states.coordinates.p[4], mean[3:], rtol=1e-6)
    assert lively.context == 5 and lively.anchor(7) == 4
    assert built(getkey(), regime="forward_backward").anchor(5) == 2


def test_the_encoder_sees_the_order_of_the_frames(lively, getkey):
    frames = jax.random.uniform(getkey(), (5, 16, 16, 3))
    forward, reverse = lively.posterior(frames).mean, lively.posterior(frames[::-1]).mean
    assert float(jnp.abs(forward - reverse).max()) > 1e-3


def test_inputs_act_as_forces(getkey):
    model = built(getkey(), inputs=2)
    state = model.state(jax.random.normal(getkey(), (6,)))
    u = jnp.array([0.3, -2.0])
    q, p = state.coordinates
    derivative = model.hamiltonian.derivative(state.coordinates, u)
    expected = model.hamiltonian.input_matrix(q) @ u - jax.grad(model.hamiltonian.potential)(q)
    np.testing.assert_allclose(derivative.p, expected, rtol=1e-5)
    held = model.rollout(state, DT, jnp.broadcast_to(u, (4, 2)), 4)
    np.testing.assert_allclose(held.coordinates.q, model.rollout(state, DT, u, 4).coordinates.q, rtol=1e-6)
    with pytest.raises(KeycldError, match="has 2 inputs, not 0"):
        model.infer(jnp.zeros((5, 16, 16, 3)), DT, jnp.zeros(0))


def test_without_inputs_there_is_no_input_matrix(getkey):
    model = built(getkey())
    assert model.hamiltonian.input_matrix is None
    assert isinstance(model, HasEnergies) and isinstance(model, Reversible)
    assert not isinstance(model, HasKeypoints) and not isinstance(model, HasInputMatrix)


def test_frames_of_another_size_are_refused(lively):
    with pytest.raises(KeycldError, match="frames of 16 × 16 pixels"):
        lively.infer(jnp.zeros((5, 32, 32, 3)), DT, jnp.zeros(0))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"regime": "back"}, "unknown regime 'back'"),
        ({"latent": 5}, "latent is an even number"),
        ({"regime": "forward_backward", "given": 4}, "odd number of given frames"),
        ({"regime": "given", "consistency": 0.001}, "no frames beyond the given ones to compare"),
        ({"consistency": 0.001, "batch": 1}, "set batch to 2 or more, or consistency to 0"),
        ({"regime": "forward_backward", "batch": 1}, "batch of 2 or more"),
        ({"batch": 0}, "batch is at least 1"),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings, words):
    with pytest.raises(KeycldError, match=words):
        config_for("hgn", "released", **settings)


def test_windows_are_those_of_the_benchmark():
    """64 frames forward, 65 both ways, and whole trajectories where they are shorter."""
    long, short = scene(frames=256), scene(frames=20)
    both = config_for("hgn", "released", regime="forward_backward")
    assert [config_for("hgn", "released").window(s) for s in (long, short)] == [64, 20]
    assert [both.window(s) for s in (long, short)] == [65, 20]
    with pytest.raises(KeycldError, match="trajectories have 5"):
        config_for("hgn", "released").window(scene(frames=5))
