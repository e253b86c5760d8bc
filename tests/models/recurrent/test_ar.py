"""AR: pictures that follow from pictures."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.data import Clip, resident
from keycld.models import Scene, config_for
from keycld.models.base import HasEnergies, Reversible
from keycld.models.recurrent.losses import NextFrameLoss
from keycld.training.step import initial_progress, make_step
from scenes import disc_pendulum

TINY = {"channels": 4, "hidden": 8, "layers": 3, "latent": 6}
DT = jnp.array(0.05)
CELLS = ("vanilla", "lstm", "gru")


def built(key, inputs=0, **settings):
    return config_for("ar", "released", **TINY, **settings).build(Scene(16, 16, inputs, 20, 0.05, 3), key)


@pytest.fixture
def frames(getkey):
    return jax.random.uniform(getkey(), (7, 16, 16, 3))


def clip(frames, u):
    """A batch of one window."""
    count = frames.shape[0]
    return Clip(frames[None], None, jnp.arange(count)[None], u[None], jnp.full(1, 0.05), count)


@pytest.mark.parametrize(("cell", "expected"), [("vanilla", 883_183), ("lstm", 2_248_819), ("gru", 1_793_263)])
def test_it_has_the_number_of_weights_of_the_benchmark(cell, expected):
    build = config_for("ar", "released", cell=cell).build
    model = eqx.filter_eval_shape(build, Scene(32, 32, 0, 256, 0.05, 100), jax.random.key(0))
    assert sum(leaf.size for leaf in jax.tree.leaves(model)) == expected


def test_the_paper_has_four_recurrent_layers(getkey):
    config = config_for("ar", "paper")
    assert (config.layers, config.rate) == (4, 5e-4)
    model = config.build(Scene(16, 16, 0, 20, 0.05, 3), getkey())
    assert [cell.hidden for cell in model.stack.cells] == [250, 250, 250, 32]


@pytest.mark.parametrize(("cell", "inputs"), [("vanilla", 0), ("lstm", 0), ("gru", 2)])
def test_teacher_forcing_is_feeding_true_frames_one_at_a_time(cell, inputs, getkey, frames):
    """After each step, the predicted picture is compared with the true frame and then replaced by it."""
    model, u = built(getkey(), inputs, cell=cell), jax.random.normal(getkey(), (7, inputs))

    @jax.jit
    def step(state, u):
        return jax.tree.map(lambda path: path[-1], model.rollout(state, DT, u[None], 1))

    state, errors = model.infer(frames[:1], DT, u), []
    for k in range(1, 7):
        state = step(state, u[k - 1])
        errors.append(np.mean((np.asarray(model.render(state), np.float64) - np.asarray(frames[k])) ** 2))
        state = eqx.tree_at(lambda s: s.coordinates.picture, state, frames[k])
    loss, terms = NextFrameLoss(0, 100)(model, clip(frames, u), key=getkey(), step=jnp.array(0))
    assert float(terms["squared_error"]) == pytest.approx(np.mean(errors), rel=1e-5)
    assert float(loss) == pytest.approx(np.mean(errors) + 0.5 * np.log(np.pi), rel=1e-5)


def test_after_the_given_frames_its_own_pictures_are_fed_back(getkey, frames):
    """Given frames stand for themselves; each later one is what the model predicts from all frames before it."""
    model = built(getkey(), cell="lstm")
    nothing = jnp.zeros(0)
    found = model.predict(frames[:5], DT, nothing, 9)
    np.testing.assert_array_equal(found.frames[:5], frames[:5])
    for k in (5, 8):
        last = model.infer(found.frames[:k], DT, nothing)
        after = model.rollout(last, DT, nothing, 1)
        np.testing.assert_allclose(found.frames[k], after.coordinates.picture[1], atol=1e-5)


def test_more_given_frames_are_all_used(getkey, frames):
    model = built(getkey())
    assert (model.context, model.anchor(7)) == (5, 6)
    found = model.predict(frames, DT, jnp.zeros(0), 9).frames
    changed = model.predict(frames.at[5].set(0.0), DT, jnp.zeros(0), 9).frames
    assert float(jnp.abs(found[7:] - changed[7:]).max()) > 1e-6


def test_one_given_frame_is_enough(getkey, frames):
    model = built(getkey(), given=1)
    found = model.predict(frames[:1], DT, jnp.zeros(0), 3).frames
    cells = model.stack(model.stack.initial(), model.encoder(frames[0]))
    np.testing.assert_allclose(found[1], model.decoder(cells[1]), rtol=1e-5)


def test_inputs_act_on_the_next_frame(getkey, frames):
    """u[k] is held from frame k to k + 1: it changes frame k + 1 and none before."""
    model, u = built(getkey(), inputs=1), jnp.zeros((9, 1))
    plain = model.predict(frames[:5], DT, u, 9).frames
    pushed = model.predict(frames[:5], DT, u.at[6].set(5.0), 9).frames
    np.testing.assert_array_equal(pushed[:7], plain[:7])
    assert float(jnp.abs(pushed[7] - plain[7]).max()) > 1e-6
    with pytest.raises(KeycldError, match="has 1 inputs, not 0"):
        model.infer(frames, DT, jnp.zeros(0))


def test_it_knows_no_physics_and_cannot_run_backward(getkey, frames):
    model = built(getkey())
    assert not isinstance(model, Reversible) and not isinstance(model, HasEnergies)
    with pytest.raises(KeycldError, match="cannot run backward"):
        model.predict(frames[:5], DT, jnp.zeros(0), 9, first=2)


def test_frames_in_chunks_give_the_same_loss_and_gradient(getkey, frames):
    """Three windows of six predicted frames: two at a time, and all at once."""
    model = built(getkey())
    windows = jnp.stack([frames, frames[::-1], frames**2])
    window = Clip(windows, None, jnp.zeros((3, 7), int), jnp.zeros((3, 7, 0)), jnp.full(3, 0.05), 7)

    def loss(model, at_once):
        return NextFrameLoss(0, at_once)(model, window, key=jax.random.key(0), step=jnp.array(0))[0]

    whole, parts = (eqx.filter_jit(eqx.filter_value_and_grad(lambda m, n=n: loss(m, n)))(model) for n in (100, 12))
    for one, other in zip(jax.tree.leaves(whole), jax.tree.leaves(parts), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-3, atol=1e-6)


def test_a_few_steps_of_training_lower_the_loss(getkey):
    data = resident(disc_pendulum(4, 12, seed=0))
    config = config_for("ar", "released", **TINY, batch=4, steps=40, rate=3e-3)
    scene = Scene(16, 16, 1, 12, 0.05, 4)
    (stage,) = config.stages(scene)
    model = config.build(scene, getkey())
    progress, rest = initial_progress(stage, model)
    _, terms = make_step(stage, 0, 0, 40)((rest, data), progress)
    losses = np.asarray(terms["squared_error"])
    assert losses[-5:].mean() < 0.5 * losses[:5].mean()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"cell": "lstn"}, "did you mean 'lstm'"),
        ({"window": 1}, "2 frames or more"),
        ({"given": 0}, "given is at least 1"),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings, words):
    with pytest.raises(KeycldError, match=words):
        config_for("ar", "released", **settings)
