"""LGN, ODE, RGN and the original HGN against their equations, written out in NumPy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from keycld._errors import KeycldError
from keycld.mechanics import DormandPrince, Motion, State, integrator_named
from keycld.models import Scene, config_for
from keycld.models.base import HasEnergies, Reversible

TINY = {"channels": 4, "hidden": 8, "depth": 2, "latent": 6}
DT = jnp.array(0.05)
PARAMETERS = {
    ("hgn", "released"): 882_561,
    # The multiplier of GECO is the 645,542th.
    ("hgn", "original"): 645_541,
    ("lgn", "released"): 916_446,
    ("ode", "released"): 705_687,
    ("ode-tr", "released"): 705_687,
    ("rgn", "released"): 705_687,
    ("rgn-res", "released"): 705_687,
}


def built(key, model, inputs=0, preset="released", **settings):
    return config_for(model, preset, **TINY, **settings).build(Scene(16, 16, inputs, 20, 0.05, 3), key)


def network(layers, x):
    """A SwishMLP in float64."""
    for k, layer in enumerate(layers):
        x = x @ np.asarray(layer.kernel, np.float64) + np.asarray(layer.bias, np.float64)
        if k < len(layers) - 1:
            x = x / (1 + np.exp(-x))
    return x


@pytest.mark.parametrize(("model", "preset"), PARAMETERS)
def test_numbers_of_weights_are_those_of_the_benchmark(model, preset):
    config = config_for(model, preset)
    blank = eqx.filter_eval_shape(config.build, Scene(32, 32, 0, 256, 0.05, 100), jax.random.key(0))
    assert sum(leaf.size for leaf in jax.tree.leaves(blank)) == PARAMETERS[model, preset]


def test_lgn_moves_as_the_euler_lagrange_equations_say(getkey):
    """d/dt ∂L/∂q̇ = ∂L/∂q + g u with M = UᵀU + λI, by differences of L in float64, and the energies are T and V."""
    model = built(getkey(), "lgn", inputs=2, mass_offset=0.7)
    law, m = model.law, 3
    q, v = np.asarray(jax.random.normal(getkey(), (2, m)), np.float64)
    u = np.array([0.4, -1.1])

    def mass(q):
        upper = np.zeros((m, m))
        upper[np.triu_indices(m)] = network(law.factor.network.layers, q)
        return upper.T @ upper + 0.7 * np.eye(m)

    def potential(q):
        return network(law.potential.network.layers, q)[0]

    def lagrangian(q, v):
        return 0.5 * v @ mass(q) @ v - potential(q)

    step, unit = 1e-4, np.eye(m)
    slope = np.array([(lagrangian(q + step * e, v) - lagrangian(q - step * e, v)) / (2 * step) for e in unit])
    # ∂/∂q (M v) along v.
    change = (mass(q + step * v) @ v - mass(q - step * v) @ v) / (2 * step)
    push = np.asarray(law.input_matrix(jnp.asarray(q, jnp.float32)), np.float64) @ u
    expected = np.linalg.solve(mass(q), slope - change + push)
    found = law.acceleration(jnp.asarray(q, jnp.float32), jnp.asarray(v, jnp.float32), jnp.asarray(u, jnp.float32))
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=2e-5)
    state = model.state(jnp.asarray(np.concatenate([q, v]), jnp.float32))
    assert float(model.kinetic_energy(state)) == pytest.approx(0.5 * v @ mass(q) @ v, rel=1e-4)
    assert float(model.potential_energy(state)) == pytest.approx(potential(q), rel=1e-4, abs=1e-6)


def test_lgn_as_released_takes_the_mid_point_rule(getkey):
    model = built(getkey(), "lgn")
    state = model.state(jax.random.normal(getkey(), (6,)))
    (q, v), h, off = state.coordinates, 0.125, jnp.zeros(0)
    middle = q + h / 2 * v, v + h / 2 * model.law.acceleration(q, v, off)
    expected = Motion(q + h * middle[1], v + h * model.law.acceleration(*middle, off))
    found = model.rollout(state, DT, off, 1).coordinates
    np.testing.assert_allclose(found.x[1], expected.x, rtol=1e-5)
    np.testing.assert_allclose(found.v[1], expected.v, rtol=1e-5)
    assert config_for("lgn", "paper").integrator == "adaptive"


@pytest.mark.parametrize("integrator", ["rk2", "adaptive"])
def test_ode_follows_its_field_forward_and_backward(getkey, integrator):
    """20 frames of an eighth each, in float64: the mid-point rule step by step, error control against SciPy."""
    model = built(getkey(), "ode", integrator=integrator)
    model = eqx.tree_at(lambda m: m.dynamics, model, jax.tree.map(lambda w: 2.0 * w, model.dynamics))
    state = model.state(jax.random.normal(getkey(), (6,)))
    layers, first = model.dynamics.field.network.layers, np.asarray(state.coordinates, np.float64)
    for sign in (1, -1):
        found = model.rollout(state, sign * DT, jnp.zeros(0), 20).coordinates
        if integrator == "rk2":
            expected, h = first, sign * 0.125
            for _ in range(20):
                expected = expected + h * network(layers, expected + h / 2 * network(layers, expected))
        else:
            whole = solve_ivp(
                lambda _, s, k: k * network(layers, s), (0, 2.5), first, args=(sign,), rtol=1e-10, atol=1e-10
            )
            expected = whole.y[:, -1]
        assert np.linalg.norm(expected - first) > 0.3
        np.testing.assert_allclose(found[-1], expected, atol=1e-4 * np.abs(expected).max())


def test_the_adaptive_integrator_keeps_to_its_tolerance_where_the_field_is_fast(getkey):
    """A field a hundred times as strong: one mid-point step a frame is lost, error control is not."""
    model = built(getkey(), "ode", integrator="adaptive")
    field = eqx.tree_at(
        lambda f: f.network.layers[-1].kernel,
        model.dynamics.field,
        model.dynamics.field.network.layers[-1].kernel * 100,
    )
    state = model.state(jax.random.normal(getkey(), (6,)))
    layers = field.network.layers
    expected = solve_ivp(
        lambda t, s: network(layers, s), (0, 0.125), np.asarray(state.coordinates, np.float64), rtol=1e-10, atol=1e-10
    ).y[:, -1]
    scale = np.abs(expected).max()
    exact = DormandPrince().step(field, state, jnp.zeros(0), 0.125).coordinates
    crude = integrator_named("rk2").step(field, state, jnp.zeros(0), 0.125).coordinates
    assert np.abs(exact - expected).max() < 1e-4 * scale < np.abs(crude - expected).max()


def test_the_adaptive_integrator_is_differentiated(getkey):
    """The gradient of an end point by the initial state, against a difference."""
    field = built(getkey(), "ode", integrator="adaptive").dynamics.field
    first, direction = jax.random.normal(getkey(), (2, 6))

    @jax.jit
    @jax.value_and_grad
    def end(s):
        return jnp.sum(DormandPrince().step(field, State(s, {}), jnp.zeros(0), 1.0).coordinates ** 2)

    slope = float(end(first)[1] @ direction)
    step = 1e-2
    difference = (float(end(first + step * direction)[0]) - float(end(first - step * direction)[0])) / (2 * step)
    assert slope == pytest.approx(difference, rel=2e-3)


@pytest.mark.parametrize("model", ["rgn", "rgn-res"])
def test_rgn_applies_its_network_once_a_frame(getkey, model):
    built_model = built(getkey(), model)
    state = built_model.state(jax.random.normal(getkey(), (6,)))
    found = built_model.rollout(state, DT, jnp.zeros(0), 3).coordinates
    layers, s = built_model.dynamics.field.network.layers, np.asarray(state.coordinates, np.float64)
    for k in range(1, 4):
        s = network(layers, s) + (s if model == "rgn-res" else 0.0)
        np.testing.assert_allclose(found[k], s, rtol=1e-4, atol=1e-5)


def test_rgn_of_our_recipe_begins_at_rest(getkey):
    """Its map is the identity, so that the latent vector of the first frame reaches the last one."""
    config = config_for("rgn", "fast", channels=4, latent=6, hidden=16, depth=2)
    model = config.build(Scene(16, 16, 1, 20, 0.05, 3), getkey())
    state = model.state(jax.random.normal(getkey(), (6,)))
    found = model.rollout(state, DT, jnp.ones(1), 60).coordinates
    np.testing.assert_allclose(found, jnp.broadcast_to(state.coordinates, (61, 6)), atol=1e-4)


@pytest.mark.parametrize("model", ["lgn", "ode", "rgn"])
def test_inputs_move_every_model(getkey, model):
    built_model = built(getkey(), model, inputs=2)
    state = built_model.state(jax.random.normal(getkey(), (6,)))

    def shown(u):
        return jax.vmap(built_model.visible)(built_model.rollout(state, DT, u, 4))

    assert float(jnp.abs(shown(jnp.zeros(2)) - shown(1e5 * jnp.ones(2)))[-1].max()) > 1e-4
    later = jnp.zeros((4, 2)).at[3].set(1e5)
    np.testing.assert_array_equal(shown(jnp.zeros((4, 2)))[:4], shown(later)[:4])


def test_what_a_model_can_do_is_in_its_type(getkey):
    kinds = {name: type(built(getkey(), name)) for name in ("hgn", "lgn", "ode", "ode-tr", "rgn", "rgn-res")}
    assert {name for name, kind in kinds.items() if issubclass(kind, Reversible)} == {"hgn", "lgn", "ode", "ode-tr"}
    assert {name for name, kind in kinds.items() if issubclass(kind, HasEnergies)} == {"hgn", "lgn"}
    with pytest.raises(KeycldError, match="model rgn cannot run backward"):
        config_for("rgn", "released", regime="forward_backward")


def test_an_lgn_has_masses():
    with pytest.raises(KeycldError, match="mass_offset is above 0"):
        config_for("lgn", mass_offset=0.0)


def test_presets_differ_as_the_paper_and_its_code_do():
    for model in ("hgn", "lgn", "ode", "ode-tr", "rgn", "rgn-res"):
        released, paper = config_for(model, "released"), config_for(model, "paper")
        assert (released.rate, paper.rate) == (1.5e-4, 5e-4)
        assert (released.kl_against, paper.kl_against) == ("window", "frame")
        assert released.regime == paper.regime == ("forward_backward" if model == "ode-tr" else "forward")
        assert config_for(model, "fast").rendered == 8
    assert config_for("ode", "released").integrator == "adaptive"


def test_the_fast_recipe_lengthens_its_windows():
    """One frame, 8 and 24, then all 60 targets; both ways with the given frames as targets too."""
    scene = Scene(32, 32, 0, 256, 0.05, 100)
    for model, lengths in (("hgn", [6, 13, 29, 64]), ("ode-tr", [7, 14, 30, 65])):
        stages = config_for(model, "fast", steps=1000).stages(scene)
        assert [stage.name for stage in stages] == ["pictures", "horizon-8", "horizon-24", "horizon-all"]
        assert [stage.sampler.length for stage in stages] == lengths
        assert [stage.steps for stage in stages] == [160, 80, 120, 640]
        assert [stage.validate for stage in stages] == [False, False, False, True]
        without = config_for(model, "fast", steps=1000, pictures=0).stages(scene)
        assert [stage.steps for stage in without] == [80, 120, 800]
    with pytest.raises(KeycldError, match="the sum of settings pictures and shares is below 1, not 1.26"):
        config_for("hgn", "fast", shares=(0.5, 0.6))
    with pytest.raises(KeycldError, match="have one number for each of the first stages, not 1 and 2: set both"):
        config_for("hgn", "fast", horizons=(5000,))


def test_the_original_hgn_shows_the_map_of_positions(getkey):
    """31 frames make a state of two maps of 4×4×3; its picture does not show momenta, and a step is reversible."""
    model = built(getkey(), "hgn", preset="original")
    frames = jax.random.uniform(getkey(), (31, 16, 16, 3))
    state = model.infer(frames, DT, jnp.zeros(0))
    assert model.context == 31 and model.anchor(31) == 30
    assert state.coordinates.q.shape == state.coordinates.p.shape == (48,)
    pushed = eqx.tree_at(lambda s: s.coordinates.p, state, state.coordinates.p + 1.0)
    np.testing.assert_array_equal(model.render(pushed), model.render(state))
    there = jax.tree.map(lambda path: path[-1], model.rollout(state, DT, jnp.zeros(0), 5))
    back = jax.tree.map(lambda path: path[-1], model.rollout(there, -DT, jnp.zeros(0), 5))
    np.testing.assert_allclose(back.coordinates.q, state.coordinates.q, atol=1e-5)
    window = config_for("hgn", "original").window(Scene(32, 32, 0, 256, 0.05, 100))
    assert window == 31
