"""Forces are found where the motion asks for them, and only there."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.data import Resident, Trajectories, resident
from keycld.mechanics import (
    Constraints,
    DistanceToPoint,
    Fitted,
    FixedDistance,
    Motion,
    OnLine,
    State,
    fit_motions,
    terms_of,
    with_kinds,
)
from keycld.models import Scene, config_for
from keycld.models.keycld import fast_stages, identify, law_fit, prepare_dynamics, prepare_priors
from keycld.models.keycld.prepare_dynamics import fit_dynamics, identify_dynamics
from keycld.models.keycld.selection import Tried, select_terms
from keycld.models.keycld.tracks import Tracks
from keycld.vision import AbstractEstimator, Observation
from scenes import DT, SIZE, disc_pendulum, draw

FRAMES = 30


class Centroid(AbstractEstimator):
    """The middle of what is bright: an exact estimator of one disc."""

    def __call__(self, frame):
        axis = jnp.linspace(-1, 1, SIZE)
        light = jnp.sum(frame, axis=-1)
        light = light - light.min()
        light = light / jnp.sum(light)
        x, y = jnp.sum(light * axis[None, :]), jnp.sum(light * axis[::-1, None])
        return Observation(jnp.stack([x, y])[None], None)

    def reordered(self, order):
        return self


def recorded(x, y):
    count = len(x)
    some = disc_pendulum(count, FRAMES, seed=0)
    still = dataclasses.replace(some, image=draw(x, y), input=np.zeros((count, 0), np.float32))
    assert isinstance(still, Trajectories)
    return resident(still)


def model_of(constraints):
    config = config_for("keycld", "fast", width=8, constraints=constraints)
    model = config.build(Scene(SIZE, SIZE, 0, FRAMES, DT, 12), jax.random.key(0))
    return config, eqx.tree_at(lambda m: m.estimator, model, Centroid())


def test_the_spring_and_the_friction_of_a_cart(capsys):
    """x'' = −16 x − 0.5 x'; the learned acceleration is within a twentieth of it along the motion."""
    phase, size = np.linspace(0, 6, 12)[:, None], np.linspace(0.2, 0.6, 12)[:, None]
    time = DT * np.arange(FRAMES)
    x = size * np.exp(-0.25 * time) * np.sin(np.sqrt(16 - 0.25**2) * time + phase)
    config, model = model_of(Constraints(("cart",), (OnLine("cart"),)))
    found, _ = identify_dynamics(model, recorded(x, np.zeros_like(x)))
    assert "springs" in config.matching(found).terms and "springs" in capsys.readouterr().out
    places = jnp.stack([jnp.linspace(-0.5, 0.5, 21), jnp.zeros(21)], axis=1)
    for speed in (0.0, 2.0):
        v = jnp.array([speed, 0.0])
        learned = jax.vmap(lambda x, v=v: found.law.acceleration(x, v, jnp.zeros(0)))(places)
        np.testing.assert_allclose(learned[:, 0], -16 * places[:, 0] - 0.5 * speed, atol=0.05 * 8)


@pytest.mark.slow
def test_terms_that_do_not_act_are_dropped_at_the_end(capsys):
    phase, size = np.linspace(0, 6, 12)[:, None], np.linspace(0.2, 0.6, 12)[:, None]
    x = size * np.sin(4 * DT * np.arange(FRAMES) + phase)
    _, model = model_of(Constraints(("cart",), (OnLine("cart"),)))
    law = with_kinds(model.law, ("springs", "viscous", "coulomb"), key=jax.random.key(0))
    data = recorded(x, np.zeros_like(x))
    begun, _ = identify_dynamics(eqx.tree_at(lambda m: m.dynamics.law, model, law), data, terms=tuple(terms_of(law)))
    kept, _ = fit_dynamics(begun, data)
    assert set(terms_of(kept.law)) == {"springs", "viscous", "coulomb"}
    left, _ = fit_dynamics(begun, data, tried=Tried())
    assert set(terms_of(left.law)) == {"springs"} and "affine V, springs;" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(("takes", "found"), [(True, {"springs", "viscous"}), (False, {"springs", "drag"})])
def test_forces_that_explain_no_more_give_way_to_a_spring_and_viscous_friction(monkeypatch, takes, found):
    """x'' = −16 x − 0.5 x', where the judgement has left another friction than the one that acts."""
    phase, size = np.linspace(0, 6, 6)[:, None], np.linspace(0.2, 0.6, 6)[:, None]
    time = DT * np.arange(FRAMES)
    x = size * np.exp(-0.25 * time) * np.sin(np.sqrt(16 - 0.25**2) * time + phase)
    _, model = model_of(Constraints(("cart",), (OnLine("cart"),)))
    tracks = Tracks(jnp.stack([x, 0 * x], axis=-1), jnp.zeros((6, 0)), jnp.array(DT), jnp.zeros(1))
    law = with_kinds(model.law, ("springs", "drag"), key=jax.random.key(0))
    monkeypatch.setattr(
        identify, "select_terms", lambda fitted, *_: (eqx.tree_at(lambda d: d.law, fitted.dynamics, law), {})
    )
    tried = Tried(("springs", "viscous", "drag"), takes=takes)
    assert set(terms_of(identify.identify(model.dynamics, tracks, pixel=0.03, tried=tried).dynamics.law)) == found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("takes", "found"), [(True, {"springs", "viscous"}), (False, {"springs", "anchors", "viscous"})]
)
def test_a_fixed_point_that_pulls_must_explain_half_of_the_cost_in_a_clip(monkeypatch, takes, found):
    """It explains a little of any error. Here the judgement has left one next to the spring that acts."""
    phase, size = np.linspace(0, 6, 3)[:, None], np.linspace(0.4, 0.6, 3)[:, None]
    x = size * np.sin(4 * DT * np.arange(FRAMES) + phase)
    x += 0.002 * np.random.default_rng(0).standard_normal(x.shape)
    _, model = model_of(Constraints(("cart",), (OnLine("cart"),)))
    tracks = Tracks(jnp.stack([x, 0 * x], axis=-1), jnp.zeros((3, 0)), jnp.array(DT), jnp.zeros(1))
    monkeypatch.setattr(identify, "select_terms", lambda fitted, *_: (fitted.dynamics, {}))
    tried = Tried(("springs", "anchors", "viscous"), worth=0.0, takes=takes)
    found = terms_of(identify.identify(model.dynamics, tracks, pixel=0.03, tried=tried).dynamics.law)
    assert ("anchors" in found) != takes and {"springs", "viscous"} <= set(found)
    assert tried.needed("springs") == tried.needed("viscous") == 0.0
    assert tried.needed("anchors") == 0.5 * takes


@pytest.mark.slow
def test_one_compiled_fit_serves_laws_with_some_of_the_forces(monkeypatch):
    """Forces that do not act leave the fit what it is, and nothing of them is left."""
    phase, size = np.linspace(0, 6, 6)[:, None], np.linspace(0.2, 0.6, 6)[:, None]
    x = size * np.sin(4 * DT * np.arange(FRAMES) + phase)
    _, model = model_of(Constraints(("cart",), (OnLine("cart"),)))
    tracks = Tracks(jnp.stack([x, 0 * x], axis=-1), jnp.zeros((6, 0)), jnp.array(DT), jnp.zeros(1))
    spring = eqx.tree_at(
        lambda dynamics: dynamics.law,
        model.dynamics,
        with_kinds(model.law, ("springs",), key=jax.random.key(0)),
    )
    alone = law_fit.fit_law(spring, tracks)
    compiled = []

    def fit(dynamics, *arguments, **named):
        compiled.append(set(terms_of(dynamics.law)))
        return fit_motions(dynamics, *arguments, **named)

    monkeypatch.setattr(law_fit, "_fit", eqx.filter_jit(fit))
    shared = dataclasses.replace(tracks, among=("springs", "viscous"))
    found = law_fit.fit_law(spring, shared)
    for more in (model.dynamics, law_fit.fit_law(model.dynamics, shared).dynamics):
        assert terms_of(law_fit.fit_law(more, shared).dynamics.law) == {}
    assert compiled == [{"springs", "viscous"}]
    assert set(terms_of(found.dynamics.law)) == {"springs"}
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-4)
    right = 16.0 * model.law.masses[:, None]
    given = eqx.tree_at(lambda dynamics: dynamics.law.potential.terms["springs"].stiffness, spring, right)
    still = eqx.tree_at(lambda dynamics: dynamics.law.potential.weight, given, jnp.zeros(2))
    kept, _ = identify.explain(still, shared)
    assert float(kept.rms) < 1e-3
    np.testing.assert_array_equal(kept.dynamics.law.potential.terms["springs"].stiffness, right)


@pytest.mark.slow
def test_a_potential_of_free_form_gives_way_to_a_spring_that_explains_as_much(capsys):
    """x'' = −16 x: errors of earlier keypoints may have hidden the spring."""
    phase, size = np.linspace(0, 6, 12)[:, None], np.linspace(0.2, 0.6, 12)[:, None]
    x = size * np.sin(4 * DT * np.arange(FRAMES) + phase)
    _, model = model_of(Constraints(("cart",), (OnLine("cart"),)))
    data = recorded(x, np.zeros_like(x))
    alone, _ = identify_dynamics(model, data, terms=())
    law = with_kinds(alone.law, ("perceptron",), key=jax.random.key(0))
    begun, _ = fit_dynamics(eqx.tree_at(lambda m: m.dynamics.law, alone, law), data)
    found, _ = fit_dynamics(begun, data, tried=Tried())
    assert set(terms_of(begun.law)) == {"perceptron"} and set(terms_of(found.law)) == {"springs"}
    assert "affine V, springs;" in capsys.readouterr().out
    places = jnp.stack([jnp.linspace(-0.5, 0.5, 21), jnp.zeros(21)], axis=1)
    learned = jax.vmap(lambda x: found.law.acceleration(x, jnp.zeros(2), jnp.zeros(0)))(places)
    np.testing.assert_allclose(learned[:, 0], -16 * places[:, 0], atol=0.05 * 8)


def test_a_pendulum_has_gravity_alone(capsys):
    some = disc_pendulum(12, FRAMES, seed=0)
    angle = some.state[..., 0]
    free = some.input[:, 0] == 0
    config, model = model_of(Constraints(("disc",), (DistanceToPoint("disc", (0.0, 0.0)),)))
    data = recorded(0.6 * np.sin(angle[free]), -0.6 * np.cos(angle[free]))
    found, _ = identify_dynamics(model, data)
    assert config.matching(found).terms == () and "affine V;" in capsys.readouterr().out
    force = found.law.acceleration(jnp.array([0.6, 0.0]), jnp.zeros(2), jnp.zeros(0))
    assert float(force[1]) == pytest.approx(-9.0 * 0.6, rel=0.1)


def test_an_unknown_pivot_is_found_and_reported(capsys):
    """Discs that swing around the image centre; the model begins with another pivot. A quarter of a pixel is 0.03."""
    some = disc_pendulum(12, FRAMES, seed=0, inputs=1)
    angle = some.state[..., 0]
    data = recorded(0.6 * np.sin(angle), -0.6 * np.cos(angle))
    _, model = model_of(Constraints(("bob",), (DistanceToPoint("bob", "unknown"),)))
    moved = eqx.tree_at(lambda m: m.dynamics.law.constraint_function.items[0].learned, model, jnp.array([0.3, -0.4]))
    found, _ = identify_dynamics(moved, dataclasses.replace(data, u=jnp.asarray(some.input)), terms=())
    np.testing.assert_allclose(found.law.constraint_function.unknowns["pivot_bob"], 0.0, atol=0.03)
    assert float(jnp.sqrt(found.constants[0])) == pytest.approx(0.6, abs=0.03)
    assert "pivot_bob [" in capsys.readouterr().out


def test_a_single_recording_that_a_fit_would_lose_is_followed_first():
    """A pendulum released near the upright position: fitted at once over all frames, its motion is lost."""
    _, model = model_of(Constraints(("bob",), (DistanceToPoint("bob", (0.0, 0.0)),)))
    weight = jnp.array([0.0, 9.0 * float(model.law.masses[0])])
    dynamics = eqx.tree_at(lambda d: d.law.potential.weight, model.dynamics, weight)
    begin = Motion(0.6 * jnp.array([jnp.sin(2.9), -jnp.cos(2.9)]), jnp.zeros(2))
    start = State(begin, {"constants": model.law.constraint(begin.x)})
    path = dynamics.rollout(start, jnp.zeros(0), DT, 199).x
    seen = path + 0.02 * jax.random.normal(jax.random.key(1), path.shape)
    near = eqx.tree_at(lambda d: d.law.potential.weight, dynamics, 1.03 * weight)
    fitted, _ = identify.refit(near, Tracks(seen[None], jnp.zeros((1, 0)), jnp.array(DT), None))
    assert float(fitted.rms) < 0.022
    force = fitted.dynamics.law.acceleration(jnp.array([0.6, 0.0]), jnp.zeros(2), jnp.zeros(0))
    assert float(force[1]) == pytest.approx(-9.0, rel=0.03)


def wave(count, frames, omega):
    angle = omega * np.arange(frames) + np.arange(count)[:, None]
    return jnp.asarray(np.stack([np.sin(angle), np.cos(angle)], axis=-1), jnp.float32)


def test_halves_are_consecutive_parts_of_each_recording_with_their_inputs():
    x = wave(2, 65, 0.3)
    for u in (jnp.arange(2.0)[:, None], x[..., :1]):
        halves = Tracks(x, u, jnp.array(DT), None).halved()
        np.testing.assert_array_equal(halves.x, jnp.stack([x[0, 1:33], x[0, 33:], x[1, 1:33], x[1, 33:]]))
        np.testing.assert_array_equal(halves.u, halves.x[..., :1] if u.ndim == 3 else jnp.repeat(u, 2, axis=0))


@pytest.mark.parametrize(
    ("count", "frames", "omega", "why"),
    [(17, 64, 0.3, "many"), (1, 31, 0.6, "short"), (1, 64, 0.05, "parabolas")],
)
def test_no_halves_of_many_or_short_recordings_or_where_parabolas_explain_them(count, frames, omega, why):
    x = wave(count, frames, omega)
    assert Tracks(x, jnp.zeros((count, 0)), jnp.array(DT), None).halved() is None, why


@pytest.mark.parametrize(("followed", "expected"), [(200, 128), (40, 32), (64, 64), (8, 128)])
def test_the_longest_pieces_that_a_law_follows_are_fitted(followed, expected):
    """If it follows none, these are the whole recordings."""
    tracks = Tracks(wave(1, 128, 0.3), jnp.zeros((1, 0)), jnp.array(DT), None)
    _, model = model_of(Constraints(("disc",), (DistanceToPoint("disc", (0.0, 0.0)),)))

    def fit(pieces):
        frames = pieces.x.shape[1]
        return identify.Identified(model.dynamics, 0.01 if frames <= followed else 0.5, {"frames": float(frames)})

    found, pieces = identify.in_pieces(fit, tracks)
    assert found.worth["frames"] == pieces.x.shape[1] == expected and pieces.x.size == tracks.x.size


def test_a_fit_whose_motions_diverged_is_done_again_in_growing_parts(monkeypatch):
    """Their errors are not numbers, and no force can be judged by them."""
    _, model = model_of(Constraints(("cart",), (OnLine("cart"),)))
    x = jnp.zeros((3, 5, 2))
    still = Motion(x[:, 0], x[:, 0])
    nothing, lost, sound = (
        Fitted(
            model.dynamics,
            still,
            x,
            jnp.array([0.1, 0.1, error]),
            jnp.array(cost),
            jnp.zeros((1, 1)),
            None,
            jnp.ones(3, bool),
        )
        for cost, error in ((jnp.inf, jnp.nan), (9.0, 3.0), (1.0, 0.1))
    )
    tracks = Tracks(x, jnp.zeros((3, 0)), jnp.array(DT), None)
    monkeypatch.setattr(identify, "climb", lambda *_, **__: sound)
    for first in (nothing, lost, sound):
        monkeypatch.setattr(identify, "fit_law", lambda *_, first=first: first)
        assert identify.refit(model.dynamics, tracks)[0] is sound
    monkeypatch.setattr(identify, "climb", lambda *_, **__: nothing)
    monkeypatch.setattr(identify, "fit_law", lambda *_: nothing)
    assert identify.refit(model.dynamics, tracks, tried=Tried())[0] is nothing


def test_singular_constraints_end_the_training_with_a_sentence(monkeypatch):
    """Both ends of a dumbbell that turns around a pivot between them, held by distances alone."""
    angle = np.linspace(0, 3, 30).reshape(3, 10)
    ends = np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, :, None] * np.array([0.5, -0.35])[:, None]
    x = jnp.asarray(ends.reshape(3, 10, 4), jnp.float32)
    monkeypatch.setattr(prepare_dynamics, "observed_keypoints", lambda *_: (x, jnp.zeros((3, 0))))
    rods = Constraints(("a", "b"), (DistanceToPoint("a"), DistanceToPoint("b"), FixedDistance("a", "b")))
    scene = Scene(height=16, width=16, inputs=0, frames=10, dt=0.05, trajectories=3)
    model = config_for("keycld", "fast", width=8, constraints=rods).build(scene, jax.random.key(0))
    data = Resident(jnp.zeros((3, 10, 16, 16, 3), jnp.uint8), jnp.zeros((3, 0)), jnp.array(0.05))
    with pytest.raises(KeycldError, match="the constraints are singular where the keypoints are"):
        identify_dynamics(model, data)


@pytest.mark.slow
def test_more_frames_may_show_another_friction():
    """x'' = −16 x − 0.5 x', where a few frames had been explained by dry friction."""
    phase, size = np.linspace(0, 6, 6)[:, None], np.linspace(0.2, 0.6, 6)[:, None]
    time = DT * np.arange(FRAMES)
    x = size * np.exp(-0.25 * time) * np.sin(np.sqrt(16 - 0.25**2) * time + phase)
    x += 0.002 * np.random.default_rng(0).standard_normal(x.shape)
    _, model = model_of(Constraints(("cart",), (OnLine("cart"),)))
    tracks = Tracks(jnp.stack([x, 0 * x], axis=-1), jnp.zeros((6, 0)), jnp.array(DT), jnp.zeros(1))
    dry = law_fit.fit_from_nothing(model.dynamics, ("springs", "coulomb"), tracks).dynamics
    tried = Tried(("springs", "viscous", "coulomb"), worth=0.05, takes=True)
    for anew, friction in ((False, "coulomb"), (True, "viscous")):
        fitted, _ = identify.refit(dry, tracks, tried=tried, anew=anew)
        assert set(terms_of(fitted.dynamics.law)) == {"springs", friction}


@pytest.mark.slow
@pytest.mark.parametrize("noise", [3e-5, 3e-4, 3e-3])
def test_forces_that_act_stay_however_clean_the_keypoints(noise):
    """x'' = −16 x − γ x' in one clip. The common factor of M, V and R has no curvature but that of rounding."""
    time = DT * np.arange(10 * FRAMES)
    for rate, kinds in ((0.5, ("springs", "viscous")), (0.02, ("springs", "viscous")), (0.0, ("springs",))):
        x = 0.6 * np.exp(-rate / 2 * time) * np.sin(np.sqrt(16 - rate**2 / 4) * time + 1)
        x = x + noise * np.random.default_rng(0).standard_normal(x.shape)
        _, model = model_of(Constraints(("cart",), (OnLine("cart"),)))
        x = jnp.asarray(np.stack([x, 0 * x], axis=-1)[None], jnp.float32)
        tried = Tried(("springs", "viscous"), worth=0.05, takes=True)
        tracks = Tracks(x, jnp.zeros((1, 0)), jnp.array(DT), None, among=tried.named)
        fitted = law_fit.fit_from_nothing(model.dynamics, ("springs", "viscous"), tracks)
        left, worth = select_terms(fitted, tracks, tried)
        assert set(terms_of(law_fit.lagrangian(left))) == set(kinds), worth
        # A mass that followed wholly would take a spring's place; it follows by a share alone.
        assert worth["springs"] > 1


@pytest.mark.parametrize(("preset", "recordings"), [("fast", 150), ("control", 225)])
def test_the_last_fit_judges_the_forces_once_more(preset, recordings, monkeypatch):
    """Those that only followed errors of the first keypoints are dropped."""
    asked = []
    for module in (prepare_dynamics, fast_stages):
        monkeypatch.setattr(module, "fit_dynamics", lambda model, data, **how: asked.append(how) or (model, data))
    for module in (prepare_priors, fast_stages):
        monkeypatch.setattr(module, "measure_velocity_prior", lambda model, data: (model, data))
    monkeypatch.setattr(fast_stages, "measure_part_light", lambda model, data: (model, data))
    config = config_for("keycld", preset, constraints=Constraints(("bob",), (DistanceToPoint("bob"),)))
    data = Resident(jnp.zeros((3, 10, 16, 16, 3), jnp.uint8), jnp.zeros((3, 0)), jnp.array(0.05))
    config.stages(Scene(height=16, width=16, inputs=0, frames=10, dt=0.05, trajectories=3))[-1].prepare(None, data)
    assert asked == [{"tried": Tried(), "trajectories": recordings}]
