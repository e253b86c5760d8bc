"""Recordings whose law has parameters of its own: they are inferred from the given frames and kept in the state."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld.data import Clip, RandomFrames, Resident
from keycld.mechanics import (
    Constraints,
    Fitted,
    MechanicalDynamics,
    OnLine,
    Own,
    PointMasses,
    Rattle,
    Springs,
    SumPotential,
    terms_of,
    with_kinds,
)
from keycld.mechanics.forces.anchors import Anchors
from keycld.mechanics.lagrangian import ConstrainedLagrangian
from keycld.models import Scene, config_for
from keycld.models.keycld import prepare_priors
from keycld.models.keycld.identify import evidence, identify, refit
from keycld.models.keycld.law_fit import climb
from keycld.models.keycld.losses import SmoothedLoss
from keycld.models.keycld.own_initial_state import OwnInitialState, OwnPrior, own_guess
from keycld.models.keycld.part_light import PartLight, most_frequent
from keycld.models.keycld.prepare_priors import measure_own_prior
from keycld.models.keycld.prepare_vision import measure_part_light
from keycld.models.keycld.selection import Tried
from keycld.models.keycld.tracks import Tracks
from keycld.systems import get
from keycld.training.runs import _changes
from keycld.vision import Observation, image_grid

SCENE = Scene(height=16, width=16, inputs=0, frames=12, dt=0.05, trajectories=6)
DT = jnp.float32(0.05)
NONE = jnp.zeros(0)


def test_the_system_says_that_its_parameters_differ():
    """Of other systems neither the settings nor the state change."""
    config = config_for("keycld", "fast").completed(get("toy/mass_spring_colors"))
    assert config.own_parameters and config.looks == 4 and config.settings()["own_parameters"] is True
    plain = config_for("keycld", "fast").completed(get("toy/mass_spring"))
    assert plain.own_parameters is None and "own_parameters" not in plain.settings()
    assert config_for("node2", "fast").completed(get("toy/mass_spring_colors")).own_parameters is None

    def state(config):
        return config.build(SCENE, jax.random.key(0)).infer(jnp.zeros((3, 16, 16, 3)), DT, NONE)

    own, other = (eqx.filter_eval_shape(state, each).parameters.keys() for each in (config, plain))
    assert {"place", "masses", "friction"} <= own and own - other == {"place", "masses", "friction", "looks"}


def recordings(count, frames, seed):
    """Discs of three colours on springs: the light shows the mass to 2 %, places and amplitudes do not show."""
    random = np.random.default_rng(seed)
    place, mass = random.uniform(-0.3, 0.3, (count, 2)), random.uniform(0.3, 1.5, count)
    size, phase = random.uniform(0.2, 0.5, (count, 1)), random.uniform(0, 6, (count, 1))
    y = size * np.cos(np.sqrt(2 / mass)[:, None] * 0.05 * np.arange(frames) + phase)
    paths = place[:, None] + np.stack([np.zeros_like(y), y], axis=-1)
    colour = np.array([[0.7, -0.3, -0.4], [-0.3, 0.7, -0.4], [-0.3, 0.7, 0.6]])[random.integers(3, size=count)]
    seen, size = mass * (1 + 0.02 * random.normal(size=count)), np.linalg.norm(colour, axis=1)
    light = np.concatenate([np.log(seen * size)[:, None], colour / size[:, None]], axis=1)
    return place, mass, light, paths


def on_a_line(**terms):
    """A unit mass that moves along y, with these terms of V."""
    phi = Constraints(("disc",), (OnLine("disc", direction=(0.0, 1.0)),))
    potential = SumPotential(jnp.zeros(2), terms)
    return MechanicalDynamics(ConstrainedLagrangian(PointMasses.ones(1), potential, None, phi), Rattle(substeps=2))


@pytest.fixture(scope="module")
def learned():
    place, mass, light, paths = recordings(120, 5, 0)
    own = np.concatenate([place, np.log(mass)[:, None], np.zeros((120, 1))], axis=1)
    return OwnPrior.measured(own, paths, light, np.zeros((120, 1)))


def test_a_prior_knows_what_is_seen_and_that_other_numbers_do_not_differ(learned):
    """A deviation of 2 % for masses that vary by half; friction, which is the same for all, has none."""
    spread = np.sqrt(np.diag(np.asarray(learned.factor_root @ learned.factor_root.T)))
    assert 0.015 < spread[0] < 0.06 and spread[1] < 2e-3
    place, mass, light, paths = recordings(50, 5, 1)
    factors = jax.jit(jax.vmap(learned.expected_factors))(jnp.asarray(light, jnp.float32)[:, None], jnp.zeros((50, 1)))
    assert np.std(factors[:, 0] - np.log(mass)) < 0.06
    places = np.asarray(jax.jit(jax.vmap(learned.expected_place))(jnp.asarray(paths, jnp.float32)))
    away = (places - place) / np.sqrt(np.diag(np.asarray(learned.place_root @ learned.place_root.T)))
    assert np.mean(np.abs(away[:, 1]) < 2) > 0.8


def test_a_number_that_cannot_be_seen_does_not_blur_the_others(learned):
    """Fits of friction, the same for all, scatter by 3 %: masses are known as well as with exact friction."""
    place, mass, light, paths = recordings(120, 5, 0)
    friction = 0.03 * np.random.default_rng(1).normal(size=120)
    own = np.concatenate([place, np.log(mass)[:, None], friction[:, None]], axis=1)
    found = OwnPrior.measured(own, paths, light, np.zeros((120, 1)))
    spread, before = (np.sqrt(np.diag(np.asarray(each.factor_root @ each.factor_root.T))) for each in (found, learned))
    assert spread[0] == pytest.approx(before[0], rel=0.05) and 0.02 < spread[1] < 0.04


def test_friction_is_told_by_mass_and_length():
    """φ ∝ 1 / (m l²): the light shows m, and l² is the constant around the place."""
    random = np.random.default_rng(2)
    mass, squared = random.uniform(0.5, 1.5, 120), random.uniform(0.1, 0.5, 120)
    light = np.stack([np.log(mass), *0.58 * np.ones((3, 120))], axis=1)
    own = np.stack([*np.zeros((2, 120)), np.zeros(120), -np.log(mass * squared)], axis=1)
    found = OwnPrior.measured(own, np.zeros((120, 5, 2)), light, squared[:, None])
    assert found.powers[0] == 1 and float(jnp.abs(found.factor_root[1]).max()) < 0.02
    ahead = eqx.filter_jit(found.expected_factors)(jnp.asarray(light[:1], jnp.float32), jnp.asarray(squared[:1]))
    assert float(ahead[1]) == pytest.approx(own[0, 3], abs=0.02)


def test_the_light_of_a_part_is_a_sum_over_its_pixels():
    """Two squares of 4 and 16 pixels, far apart, on a background that is not black."""
    background = jnp.full((32, 32, 3), 0.3)
    frame = background.at[5:7, 5:7, 0].add(0.5).at[20:24, 20:24, 2].add(-0.2)
    keypoints = jnp.array([[[5.5 - 15.5, 15.5 - 5.5], [21.5 - 15.5, 15.5 - 21.5]]]) / 15.5
    light = PartLight(background, jnp.zeros(()))
    size, direction = np.split(np.asarray(eqx.filter_jit(light)(frame[None], keypoints)), [1], axis=1)
    np.testing.assert_allclose(np.exp(size[:, 0]) * 1024 / 100, [4 * 0.5, 16 * 0.2], rtol=1e-4)
    np.testing.assert_allclose(direction, [[1, 0, 0], [0, 0, -1]], atol=1e-4)
    still = np.asarray(eqx.filter_jit(light)(background[None], keypoints))
    assert np.all(np.isfinite(still)) and np.all(still[:, 1:] == 0)
    np.testing.assert_array_equal(eqx.filter_jit(light.moved)(frame[None], keypoints), keypoints)


def a_part(shape, count=24, frames=12, radius=0.15):
    """Return pictures `[N, T, 32, 32, 3]` of a disc, or of a square, that moves along y."""
    y = np.random.default_rng(0).uniform(-0.7, 0.5, (count, 1)) + 0.02 * np.arange(frames)
    away = np.abs(np.asarray(image_grid(32, 32)) - np.stack([0 * y, y], axis=-1)[:, :, None, None])
    size = np.linalg.norm(away, axis=-1) if shape == "disc" else np.max(away, axis=-1)
    mask = 1 / (1 + np.exp((size - radius) / 0.025))
    return jnp.asarray(np.round(255 * (0.2 + 0.5 * mask[..., None] * np.array([1, 0.2, -0.3]))), jnp.uint8)


class MiddleOfLight(eqx.Module):
    """An estimator that sees the middle of what is not grey, so many image-plane units too far right."""

    off: float

    def __call__(self, frame):
        light = jnp.sum(jnp.abs(frame - 0.2), axis=-1, keepdims=True)
        middle = jnp.sum(light * image_grid(*frame.shape[:2]), axis=(0, 1)) / jnp.sum(light)
        return Observation(middle[None] + jnp.array([[self.off, 0.0]]), None)


@pytest.mark.parametrize(
    ("shape", "pixels", "taken"), [("disc", 0.3, True), ("square", 0.3, False), ("disc", 3, False)]
)
def test_discs_that_explain_the_light_and_are_near_are_taken(shape, pixels, taken):
    config = config_for("keycld", "fast", width=8).completed(get("toy/mass_spring_colors"))
    scene = dataclasses.replace(SCENE, height=32, width=32)
    model = config.build(scene, jax.random.key(0))
    model = eqx.tree_at(lambda m: m.estimator, model, MiddleOfLight(pixels * 2 / 31))
    data = Resident(a_part(shape), jnp.zeros((24, 0)), DT)
    found = measure_part_light(model, data)[0].part_light
    assert bool(found.discs) is taken
    np.testing.assert_allclose(found.background[:4], 0.2, atol=1e-6)
    assert not measure_part_light(model, data, discs=False)[0].part_light.discs


@pytest.mark.parametrize(("shape", "taken"), [("disc", True), ("square", False)])
def test_a_model_of_discs_is_built_again_from_its_settings(shape, taken):
    """Also where no parameters differ; of other parts it does not look at the light."""
    config = config_for("keycld", "fast", width=8, terms=("springs",)).completed(get("toy/mass_spring"))
    scene = dataclasses.replace(SCENE, height=32, width=32)
    model = config.build(scene, jax.random.key(0))
    assert model.part_light is None and "discs" not in config.settings()
    model = eqx.tree_at(lambda m: m.estimator, model, MiddleOfLight(0.3 * 2 / 31))
    model, _ = measure_part_light(model, Resident(a_part(shape), jnp.zeros((24, 0)), DT))
    assert (model.part_light is not None) is taken
    changes = _changes(config, config.matching(model))
    assert changes == ({"discs": True} if taken else {})
    built = config.changed(changes).build(scene, jax.random.key(0))
    assert jax.tree.structure(built.part_light) == jax.tree.structure(model.part_light)


def test_discs_of_two_recordings_have_sizes_of_their_own():
    """Seen together they are where each is seen alone."""
    model = config_for("keycld", "fast", width=8, discs=True).completed(get("toy/mass_spring"))
    model = model.build(dataclasses.replace(SCENE, height=32, width=32), jax.random.key(0))
    light = PartLight(jnp.full((32, 32, 3), 0.2), jnp.ones(()))
    model = eqx.tree_at(lambda m: (m.estimator, m.part_light), model, (MiddleOfLight(0.3 * 2 / 31), light))
    frames = jnp.stack([a_part("disc", radius=radius)[0, :4] for radius in (0.12, 0.25)]).astype(jnp.float32) / 255
    together = eqx.filter_jit(model.observe_clips)(frames).keypoints
    alone = [eqx.filter_jit(model.observe_clips)(frames[k : k + 1]).keypoints for k in range(2)]
    np.testing.assert_allclose(together, jnp.concatenate(alone), atol=1e-6)
    np.testing.assert_allclose(together[:, :, 0], 0, atol=4e-4)


def test_keypoints_of_discs_are_their_centres_and_far_ones_stay():
    """The second frame shows the disc four pixels from where the network sees it."""
    image = a_part("disc")[0, :3].astype(jnp.float32) / 255
    light = PartLight(jnp.full((32, 32, 3), 0.2), jnp.ones(()))
    y = np.random.default_rng(0).uniform(-0.7, 0.5, (24, 1))[0] + 0.02 * np.arange(3)
    true = np.stack([0 * y, y], axis=-1)[:, None]
    seen = jnp.asarray(true + np.array([0.01, 0.26, -0.01])[:, None, None], jnp.float32)
    found = eqx.filter_jit(light.moved)(image, seen)
    np.testing.assert_allclose(found[::2], true[::2], atol=4e-4)
    np.testing.assert_array_equal(found[1], seen[1])
    size = eqx.filter_jit(light)(image, jnp.asarray(true, jnp.float32))
    grey = np.asarray(image[0]) - 0.2
    np.testing.assert_allclose(np.exp(size[0, 0]), np.linalg.norm(grey.sum((0, 1))) * 100 / 1024, rtol=0.01)


def test_the_background_is_what_a_pixel_shows_most_often():
    """In three of five frames it is a little brighter, each time by another amount."""
    frames = np.full((5, 2, 2, 3), 81, np.uint8)
    frames[2:, 0, 0, 1] = [82, 83, 90]
    assert np.median(frames, axis=0)[0, 0, 1] == 82
    np.testing.assert_allclose(most_frequent(frames), 81 / 255)


def test_five_frames_predict_a_hundred(learned):
    """With the mass seen and observations exact to 1e-4, a period later the error is a fifth of the amplitudes'."""
    dynamics = on_a_line(springs=Springs(jnp.array([[2.0]])))
    initial = OwnInitialState(learned, jnp.array([1e-4]))
    place, mass, light, paths = recordings(20, 101, 2)
    seen = paths[:, :5] + 1e-4 * np.random.default_rng(3).normal(size=(20, 5, 2))

    def predict(x, light):
        state, _ = initial.smooth(dynamics, x, DT, NONE, light)
        return dynamics.rollout(state, NONE, DT, 100).x, state.parameters

    predict = jax.jit(jax.vmap(predict))
    ahead, found = predict(jnp.asarray(seen, jnp.float32), jnp.asarray(light, jnp.float32)[:, None])
    assert np.median(np.abs(np.log(found["masses"][:, 0]) - np.log(mass))) < 0.03
    assert np.median(np.abs(found["place"] - place)) < 0.01
    assert np.median(np.linalg.norm(ahead[:, 100] - paths[:, 100], axis=1)) < 0.07
    unseen, _ = predict(jnp.asarray(seen, jnp.float32), jnp.broadcast_to(learned.seen_mean[:4], (20, 1, 4)))
    assert np.median(np.linalg.norm(unseen[:, 100] - paths[:, 100], axis=1)) > 0.07


def test_more_exact_observations_tell_places_better(learned):
    """The steps end near the optimum, although errors of 1e-5 make one part of the matrix 1e9 times the other."""
    initial = OwnInitialState(learned, jnp.array([1e-5]))
    dynamics = on_a_line(springs=Springs(jnp.array([[2.0]])))
    place, _, light, paths = recordings(20, 5, 2)
    seen = paths + 1e-5 * np.random.default_rng(3).normal(size=paths.shape)
    find = jax.jit(jax.vmap(lambda x, light: initial.smooth(dynamics, x, DT, NONE, light)[0].parameters["place"]))
    found = find(jnp.asarray(seen, jnp.float32), jnp.asarray(light, jnp.float32)[:, None])
    assert np.quantile(np.abs(found - place), 0.9) < 0.02


def test_frames_with_fitted_positions_are_sampled():
    cached = jnp.full((4, 12, 2), jnp.nan).at[1, 3:7].set(1.0).at[2, 5:9].set(2.0)
    image = jnp.zeros((4, 12, 16, 16, 3), jnp.uint8)
    data = Resident(image, jnp.zeros((4, 0)), DT, cached)
    clips = RandomFrames(32, 2, cached=True)(data, jax.random.key(0), jnp.array(3))
    assert clips.frames is not None and clips.frames.shape[:2] == (32, 2)
    values = np.asarray(clips.cached)
    assert set(values.ravel()) == {1.0, 2.0}
    first, second = np.asarray(clips.index).T
    assert np.all(first != second)
    assert np.all((clips.index >= np.where(values[:, :1, 0] == 1, 3, 5)) & (clips.index < 9))


def test_keypoints_learn_fitted_positions(getkey):
    """The gradient of L_t alone moves the keypoint towards them."""
    config = config_for("keycld", "fast", width=8).completed(get("toy/mass_spring_colors"))
    model = config.build(SCENE, jax.random.key(0))
    frames = jax.random.uniform(getkey(), (1, 2, 16, 16, 3))
    fitted = jnp.array([[[0.3, 0.2], [0.1, -0.4]]])
    clips = Clip(frames, fitted, jnp.arange(2)[None], jnp.zeros((1, 0)), DT[None], 2)

    @eqx.filter_jit
    def distance(model):
        seen = jax.vmap(model.observe)(frames[0]).keypoints
        return jnp.sum((seen.reshape(2, 2) - fitted[0]) ** 2)

    def loss(model):
        return SmoothedLoss(heat_map=0.0)(model, clips, key=jax.random.key(0), step=jnp.array(0))[1]["track"]

    slopes = eqx.filter_jit(eqx.filter_grad(loss))(model)
    moved = eqx.apply_updates(model, jax.tree.map(lambda s: None if s is None else -1e-2 * s, slopes))
    assert float(distance(moved)) < float(distance(model))


def test_the_prior_of_masses_belongs_to_the_law_of_the_model(monkeypatch):
    """Only ω² = k/m is determined: a fit may end with twice the masses and twice the stiffness."""
    config = config_for("keycld", "fast", width=8, terms=("springs",)).completed(get("toy/mass_spring_colors"))
    model = config.build(SCENE, jax.random.key(0))
    model = eqx.tree_at(lambda m: m.dynamics, model, on_a_line(springs=Springs(jnp.array([[3.0]]))))
    _, mass, _, paths = recordings(24, 60, 0)
    seen = paths + 1e-3 * np.random.default_rng(1).normal(size=paths.shape)
    observed = jnp.asarray(seen, jnp.float32), jnp.zeros((24, 0))
    monkeypatch.setattr(prepare_priors, "observed_keypoints", lambda *_: observed)

    def refit_twice_as_heavy(dynamics, tracks):
        fitted, fitted_to = refit(dynamics, tracks)
        stiffer = eqx.tree_at(
            lambda d: d.law.potential, fitted.dynamics, replace_fn=lambda v: jax.tree.map(lambda a: 2 * a, v)
        )
        return fitted._replace(dynamics=stiffer, own=fitted.own.at[:, 2].add(jnp.log(2.0))), fitted_to

    monkeypatch.setattr(prepare_priors, "refit", refit_twice_as_heavy)
    data = Resident(jnp.zeros((24, 60, 16, 16, 3), jnp.uint8), jnp.zeros((24, 0)), DT)
    model, _ = measure_own_prior(model, data)
    mean = eqx.filter_jit(model.initial_state.prior.expected_factors)(None, jnp.zeros(1))
    stiffness = model.law.potential.terms["springs"].stiffness[0, 0] / model.law.masses[0]
    assert float(stiffness / jnp.exp(mean[0])) == pytest.approx(2 / np.exp(np.mean(np.log(mass))), rel=0.03)


def observed(error):
    """Return places, masses, and tracks of 24 recordings with errors of their positions."""
    place, mass, _, paths = recordings(24, 80, 0)
    seen = jnp.asarray(paths + error * np.random.default_rng(1).normal(size=paths.shape), jnp.float32)
    return place, mass, Tracks(seen, jnp.zeros((24, 0)), DT, None)


def guessed(place, factor):
    """Return a first guess of own parameters and a wide prior around it."""
    numbers = jnp.asarray(np.column_stack([place, factor, np.zeros(len(factor))]), jnp.float32)
    return Own(numbers, numbers, jnp.diag((1e-3 / jnp.array([0.3, 0.3, 0.5, 0.5])) ** 2))


@pytest.mark.slow
def test_motions_that_a_fit_has_lost_do_not_speak_for_the_law():
    """Two of 24 are of nothing that a spring does; the others are followed to their errors."""
    _, mass, tracks = observed(3e-4)
    t = jnp.linspace(0, 1, 80)
    x = tracks.x.at[5, :, 1].set(0.4 * jnp.sign(jnp.sin(40 * t))).at[11, :, 0].set(0.3 * jnp.sin(25 * t))
    tracks = dataclasses.replace(tracks, x=x, own=guessed(jnp.mean(x, axis=1), np.zeros(24)))
    fitted = climb(on_a_line(springs=Springs(jnp.array([[2.5]]))), tracks)
    np.testing.assert_array_equal(np.flatnonzero(~np.asarray(fitted.followed)), [5, 11])
    assert float(fitted.rms) < 3.5e-4 and np.all(np.asarray(fitted.errors)[[5, 11]] > 1e-2)
    heard = np.asarray(fitted.followed)
    ratio = np.asarray(fitted.own)[heard, 2] - np.log(mass)[heard]
    assert np.ptp(ratio) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "strength"), [(2.9, 2.1), (0.02, 5.0)])
def test_a_term_whose_part_places_take_is_dropped(stiffness, strength):
    """Next to a point outside the line, each recording has a spring of its own softness. There is none.

    The fit begins where places are a unit from that point, and frequencies are right; then also where the point does
    all that the springs should.
    """
    place, mass, tracks = observed(3e-4)
    both = on_a_line(
        springs=Springs(jnp.array([[stiffness]])), anchors=Anchors(jnp.array([strength]), jnp.zeros((1, 2)))
    )
    begin = guessed(place + np.array([1.0, 0.0]), np.log(mass * (stiffness + strength) / 2))
    fitted, _ = refit(both, dataclasses.replace(tracks, own=begin), tried=Tried())
    assert terms_of(fitted.dynamics.law).keys() == {"springs"}
    assert float(fitted.rms) < 3.5e-4


@pytest.mark.slow
def test_the_energy_that_explains_most_alone_is_found():
    """All terms together, from nothing, end where a fixed point beside the line does a part of what springs do."""
    _, _, tracks = observed(1e-3)
    begin = guessed(np.mean(tracks.x, axis=1), np.zeros(24))
    tried = Tried(kinds=("springs", "anchors"))
    found = identify(on_a_line(), dataclasses.replace(tracks, own=begin), pixel=2 / 32, tried=tried)
    assert terms_of(found.dynamics.law).keys() == {"springs"}
    assert found.rms < 1.1e-3


@pytest.mark.parametrize(("cost", "begun"), [(0.5, {"springs", "viscous"}), (1.5, {"springs"})])
def test_all_terms_are_fitted_from_a_law_with_viscous_friction_where_it_explains_more(monkeypatch, cost, begun):
    """Each fit has a given cost; a pendulum without friction lost a motion, and nothing told of its friction."""
    _, _, tracks = observed(1e-3)
    own = guessed(np.mean(tracks.x, axis=1), np.zeros(24))
    costs = {(): 4.0, ("springs",): 1.0, ("anchors",): 2.0, ("springs", "viscous"): cost}

    def fitted(dynamics, kinds, _):
        law = with_kinds(dynamics.law, kinds, key=jax.random.key(0))
        dynamics = eqx.tree_at(lambda each: each.law, dynamics, law)
        return Fitted(dynamics, None, None, None, jnp.array(costs[kinds]), jnp.zeros((0, 0)), None, None)

    module = "keycld.models.keycld.identify"
    monkeypatch.setattr(f"{module}.fit_from_nothing", fitted)
    monkeypatch.setattr(f"{module}.fit_law", lambda dynamics, tracks, begin: begin)
    monkeypatch.setattr(
        f"{module}.select_terms",
        lambda fitted, *_: (fitted.dynamics, dict.fromkeys(terms_of(fitted.dynamics.law), 1.0)),
    )
    tried = Tried(kinds=("springs", "anchors", "viscous"))
    assert evidence(on_a_line(), dataclasses.replace(tracks, own=own), pixel=0.06, tried=tried).keys() == begun


@pytest.mark.slow
def test_two_bodies_of_unknown_masses_attract_however_rough_their_accelerations():
    """A regression of accelerations, with all masses alike, begins a fit that ends at errors of 0.022."""
    system = get("toy/two_body_colors")
    recording = system.record(range(300, 316), 80, "released", "32")
    paths = recording.state[:, :, :4] / system.half_width
    lasting = 5e-3 * np.random.default_rng(1).normal(size=(16, 1, 4))
    seen = jnp.asarray(paths + lasting + 0.02 * np.random.default_rng(0).normal(size=paths.shape), jnp.float32)
    model = config_for("keycld", "fast", width=8).completed(system).build(SCENE, jax.random.key(0))
    tracks = Tracks(seen, jnp.zeros((16, 0)), DT, None, own=own_guess(model, seen))
    found = identify(model.dynamics, tracks, pixel=2 / 32, terms=("pairs",))
    assert found.rms < 0.02
