import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld._errors import KeycldError
from keycld.data import Clip
from keycld.mechanics import Constraints, DistanceToPoint, FixedDistance, MLPPotential, Rattle
from keycld.models import Scene, config_for
from keycld.models.keycld import losses
from keycld.models.keycld.collocation_loss import CollocationLoss
from keycld.models.keycld.losses import PredictionLoss, TrackLoss, VisionLoss
from keycld.vision import gaussian_maps, image_grid

SCENE = Scene(height=16, width=16, inputs=1, frames=12, dt=0.05, trajectories=6)
DISC = Constraints(("disc",), (DistanceToPoint("disc"),))
DT = jnp.array(0.05)


def fast(constraints=DISC, **settings):
    return config_for("keycld", "fast", constraints=constraints, **settings)


# Compiled as a whole: an operation at a time takes ten times as long.
predict = eqx.filter_jit(lambda model, frames, u, length: model.predict(frames, DT, u, length))


class Gravity(eqx.Module):
    """V = 9.81 y for a unit mass."""

    def __call__(self, x):
        return 9.81 * x[1]


@pytest.fixture
def model():
    """A tiny KeyCLD whose law is that of a unit pendulum of length one, without input."""
    fresh = fast(width=8, shared_constants=False).build(SCENE, jax.random.key(0))
    return eqx.tree_at(lambda m: m.dynamics.law.potential, fresh, Gravity())


@pytest.fixture
def paper_model():
    return config_for("keycld", "paper", constraints=DISC, width=8).build(SCENE, jax.random.key(0))


@eqx.filter_jit
def initial(model, x0, x1, dt, u):
    return model.initial_state(model.dynamics, jnp.stack([x0, x1]), dt, u)


@eqx.filter_jit
def moved(model, u):
    """Seven intervals from two observations."""
    state = model.initial_state(model.dynamics, jnp.stack([on_circle(1.0), on_circle(1.1)]), DT, jnp.atleast_2d(u)[0])
    return model.rollout(state, DT, u, 7).coordinates.x


def on_circle(angle):
    return jnp.array([jnp.sin(angle), -jnp.cos(angle)])


def test_the_initial_state_joins_the_two_given_positions(model):
    """A pendulum at 1 rad with 3 rad/s is at x1 after one frame; the initial state must lead there, at this speed."""
    u = jnp.zeros(1)
    fine = eqx.tree_at(lambda m: m.dynamics.integrator, model, Rattle(substeps=200))
    still = initial(fine, on_circle(1.0), on_circle(1.0), DT, u)
    later = fine.dynamics.step(
        eqx.tree_at(lambda s: s.coordinates.v, still, jnp.array([1.0, 1.5574]) * 3.0 * np.cos(1.0)), u, DT
    )
    state = initial(model, on_circle(1.0), later.coordinates.x, DT, u)
    speed = float(jnp.linalg.norm(state.coordinates.v))
    assert speed == pytest.approx(3.0, rel=2e-3)
    reached = model.dynamics.step(state, u, DT).coordinates.x
    np.testing.assert_allclose(reached, later.coordinates.x, atol=1e-4)


def test_a_plain_difference_misses_the_initial_velocity(model):
    """Over a turn of 0.3 rad a difference is wrong by more than 5 % of the velocity."""
    state = initial(model, on_circle(1.0), on_circle(1.3), DT, jnp.zeros(1))
    difference = (on_circle(1.3) - on_circle(1.0)) / DT
    solved = state.coordinates.v
    assert float(jnp.linalg.norm(difference - solved)) > 0.05 * float(jnp.linalg.norm(solved))


def test_the_initial_state_compromises_between_two_lengths(model):
    """Two observations at distances 0.9 and 1.1 from the pivot give a motion at one constant distance."""
    state = initial(model, 0.9 * on_circle(0.5), 1.1 * on_circle(0.6), DT, jnp.zeros(1))
    path = model.rollout(state, DT, jnp.zeros(1), 40).coordinates.x
    lengths = jnp.linalg.norm(path, axis=1)
    np.testing.assert_allclose(lengths, lengths[0], atol=1e-5)
    assert 0.9 < float(lengths[0]) < 1.1


def test_prediction_returns_all_frames_and_backward_undoes_forward(model, getkey):
    frames = jax.random.uniform(getkey(), (2, 16, 16, 3))
    u = jnp.zeros(1)
    assert predict(model, frames, u, 9).frames.shape == (9, 16, 16, 3)
    states = model.rollout(initial(model, on_circle(1.0), on_circle(1.1), DT, u), DT, u, 8)
    last = jax.tree.map(lambda leaf: leaf[-1], states)
    back = model.rollout(last, -DT, u, 8).coordinates.x[::-1]
    np.testing.assert_allclose(back, states.coordinates.x, atol=2e-4)


def test_prediction_sees_each_given_frame_and_no_input_after_the_last_interval(model, getkey):
    frames = jax.random.uniform(getkey(), (5, 16, 16, 3))
    u = jax.random.normal(getkey(), (8, 1))
    first = predict(model, frames, u, 6).frames
    np.testing.assert_array_equal(first, predict(model, frames, u.at[5:].set(9.0), 6).frames)
    assert float(jnp.abs(first - predict(model, frames.at[4].set(0.5), u, 6).frames).max()) > 1e-6


def test_a_given_frame_with_nan_is_named(model):
    frames = jnp.full((2, 16, 16, 3), 0.5).at[1, 3, 4, 0].set(jnp.nan)
    with pytest.raises(KeycldError, match="given frame 1 holds NaN"):
        model.predict(frames, DT, jnp.zeros(1), 5)


@pytest.mark.parametrize(
    ("frames", "u", "words"),
    [
        ((1, 16, 16, 3), (1,), "needs 2 given frames or more.*not .1, 16, 16, 3"),
        ((2, 16, 24, 3), (1,), "16 × 16 pixels.*16, 24, 3"),
        ((2, 16, 16, 3), (2,), "has 1 inputs, not 2"),
    ],
)
def test_pictures_and_inputs_of_another_system_are_named(model, frames, u, words):
    with pytest.raises(KeycldError, match=words):
        model.predict(jnp.full(frames, 0.5), DT, jnp.zeros(u), 5)


def test_varying_input_equals_constant_input_when_it_is_constant():
    model = fast(width=8, shared_constants=False).build(SCENE, jax.random.key(3))
    model = eqx.tree_at(lambda m: m.dynamics.law.input_matrix.bias, model, jnp.array([5.0, 2.0]))
    u = jnp.array([0.7])
    constant, varying, without = (moved(model, u) for u in (u, jnp.broadcast_to(u, (7, 1)), 0 * u))
    np.testing.assert_allclose(constant, varying, atol=1e-5)
    assert float(jnp.abs(constant - without).max()) > 1e-3


def test_a_common_factor_of_mass_energy_and_input_changes_nothing():
    """(M, V, g) is learned only up to one factor."""
    model = fast(width=8, shared_constants=False).build(SCENE, jax.random.key(3))
    law = lambda m: m.dynamics.law  # noqa: E731
    model = eqx.tree_at(
        lambda m: (law(m).potential.weight, law(m).input_matrix.bias),
        model,
        (jnp.array([0.3, 9.0]), jnp.ones(2)),
    )
    scaled = eqx.tree_at(
        lambda m: (law(m).mass.root, law(m).potential, law(m).input_matrix),
        model,
        (
            law(model).mass.root / 2.0,  # M⁻¹ = R Rᵀ, so M is four times as large
            lambda x: 4 * law(model).potential(x),
            lambda x: 4 * law(model).input_matrix(x),
        ),
        is_leaf=lambda x: x is law(model).potential or x is law(model).input_matrix,
    )
    u = jnp.array([0.5])
    np.testing.assert_allclose(moved(model, u), moved(scaled, u), atol=1e-4)


def clips(key, batch, index, span):
    return Clip(
        frames=jax.random.uniform(key, (batch, len(index), 16, 16, 3)),
        cached=None,
        index=jnp.broadcast_to(jnp.array(index)[None], (batch, len(index))),
        u=jnp.ones((batch, 1)),
        dt=jnp.full(batch, 0.05),
        span=span,
    )


def test_collocation_loss_is_the_papers_written_out_by_hand(paper_model, getkey):
    """Eqs. (10)–(13) for one clip of seven frames, in plain NumPy around the model's own parts."""
    clip = clips(getkey(), 1, range(7), 7)
    total, terms = eqx.filter_jit(CollocationLoss(5e-4))(paper_model, clip, key=getkey(), step=jnp.array(5))
    frames, observe, renderer = (
        clip.frames[0],
        eqx.filter_jit(paper_model.observe),
        eqx.filter_jit(paper_model.renderer),
    )
    x = np.stack([np.asarray(observe(f).keypoints).reshape(-1) for f in frames])
    rendered = np.stack([np.asarray(renderer(jnp.asarray(p).reshape(1, 2))) for p in x])
    reconstruction = np.sum((rendered - np.asarray(frames)) ** 2) / 7
    h, defects = 0.05, []
    velocity = {i: (x[i + 1] - x[i - 1]) / (2 * h) for i in range(1, 6)}
    for i in range(2, 5):
        seen = (velocity[i + 1] - velocity[i - 1]) / (2 * h)
        law = paper_model.dynamics.law
        model_a = law.acceleration(jnp.asarray(x[i]), jnp.asarray(velocity[i]), jnp.ones(1))
        defects.append(np.sum((seen - np.asarray(model_a)) ** 2))
    assert float(terms["reconstruction"]) == pytest.approx(reconstruction, rel=1e-4)
    assert float(terms["dynamics"]) == pytest.approx(
        np.sum(defects) / 7, rel=2e-2, abs=1e-6
    )  # over all frames, as released
    assert float(total) == pytest.approx(reconstruction + 5e-4 * np.sum(defects) / 7, rel=1e-4)


def test_collocation_vanishes_on_a_true_motion(model):
    """Keypoints that obey eq. (6) leave almost no defect."""
    law = model.dynamics.law
    state = initial(model, on_circle(0.5), on_circle(0.5), jnp.array(0.01), jnp.zeros(1))
    x = model.rollout(state, jnp.array(0.01), jnp.zeros(1), 20).coordinates.x
    v = (x[2:] - x[:-2]) / 0.02
    a = (v[2:] - v[:-2]) / 0.02
    expected = jax.vmap(lambda x, v: law.acceleration(x, v, jnp.zeros(1)))(x[2:-2], v[1:-1])
    assert float(jnp.abs(a - expected).max()) < 0.05 * float(jnp.abs(expected).max())


def test_track_loss_is_zero_on_the_models_own_motion(model, getkey):
    """From every group, forward and backward in time, under an input that differs from frame to frame."""
    u = 3 * jax.random.normal(getkey(), (12, 1))
    state = initial(model, on_circle(0.5), on_circle(0.6), DT, u[0])
    path = model.rollout(state, DT, u[:11], 11).coordinates.x
    clip = track_clip(path, [0, 1, 4, 5, 7, 8, 10, 11], u)
    assert track(model, clip) < 1e-6
    assert track(model, eqx.tree_at(lambda c: c.cached, clip, clip.cached.at[0, 5:].add(0.1))) > 1e-3


def test_track_loss_written_out_by_hand(model, getkey):
    """Three groups of unrelated keypoints: from each one forward, and backward with negative dt."""
    index, u = [0, 1, 3, 4, 6, 7], jnp.zeros((8, 1))
    path = jnp.stack([on_circle(0.5 + 0.4 * jax.random.normal(key)) for key in jax.random.split(getkey(), 8)])
    seen = np.asarray(path[jnp.array(index)])
    gap = motions_of_groups(model, seen, index, u[0]) - seen[None]
    missed = np.sum(0.02 * (np.sqrt(1 + (gap / 0.1) ** 2) - 1), axis=-1)
    assert track(model, track_clip(path, index, u)) == pytest.approx(np.mean(missed), rel=1e-3)


def test_prediction_loss_written_out_by_hand(model, getkey):
    """Two clips of three groups; of each a frame is rendered, from the roll-out of the group or of an earlier one."""
    # Untrained networks hardly distinguish pictures or keypoints.
    outs = lambda m: (m.estimator.network.out.kernel, m.renderer.network.out.kernel)  # noqa: E731
    model = eqx.tree_at(outs, model, replace_fn=lambda kernel: 100 * kernel)
    index, key = [0, 1, 3, 4, 6, 7], jax.random.key(8)
    clip = clips(getkey(), 2, index, 8)
    total, terms = eqx.filter_jit(PredictionLoss())(model, clip, key=key, step=jnp.array(0))

    frames = np.asarray(clip.frames)
    observe = eqx.filter_jit(lambda model: jax.vmap(jax.vmap(model.observe))(clip.frames))
    keypoints, maps = (np.asarray(leaf)[:, :, 0] for leaf in observe(model)[:2])
    rolled = np.stack([motions_of_groups(model, x, index, jnp.ones(1)) for x in keypoints])
    source_key, frame_key = jax.random.split(key)
    sampled = np.asarray(jax.random.randint(source_key, (2, 3), 0, np.array([[1, 2, 3]])))
    assert np.any(sampled == [-1, 1, 2]) and np.any(sampled < [0, 1, 2])  # own and earlier roll-outs
    drawn = 2 * np.arange(3) + np.asarray(jax.random.randint(frame_key, (2, 3), 0, 2))
    assert len(np.unique(drawn % 2)) == 2
    renderer, errors, divergences = eqx.filter_jit(model.renderer), [], []
    cells = (2 * np.arange(8) + 0.5 - 7.5) / 7.5  # middles of 2 × 2 pixels
    width = max(0.05, 0.75 * (cells[1] - cells[0]))
    for b, k in np.ndindex(2, 6):
        if k in drawn[b]:
            rendered = renderer(rolled[b, sampled[b, k // 2], k][None])
            errors.append(np.sum((np.asarray(rendered) - frames[b, k]) ** 2))
        x, y = keypoints[b, k]
        blob = np.exp(-((cells[None, :] - x) ** 2 + (-cells[:, None] - y) ** 2) / (2 * width**2))
        blob = blob / blob.sum()
        divergences.append(np.sum(blob * (np.log(blob + 1e-12) - np.log(maps[b, k] + 1e-12))))
    gap = rolled - keypoints[:, None]
    missed = np.sum(2 * 0.03**2 * (np.sqrt(1 + (gap / 0.03) ** 2) - 1), axis=-1)
    squares = np.sum(keypoints**2, axis=-1)  # Φ, and |DΦ|² is four times as much
    expected = {
        "reconstruction": np.mean(errors),
        "track": np.mean(missed),
        "constraint": np.mean((squares - squares.mean()) ** 2 / (4 * squares + 1e-6)),
        "heat_map": np.mean(divergences),
    }
    weights = {"reconstruction": 1, "track": 3000, "constraint": 100, "heat_map": 1}
    assert {name: float(term) for name, term in terms.items()} == pytest.approx(expected, rel=1e-4)
    assert float(total) == pytest.approx(sum(weights[name] * expected[name] for name in weights), rel=1e-4)


@eqx.filter_jit
def both_ways(model, x0, x1, u):
    """Seven frames forward and seven backward from two observations."""
    state = model.initial_state(model.dynamics, jnp.stack([x0, x1]), DT, u)
    return [model.rollout(state, dt, u, 7).coordinates.x for dt in (DT, -DT)]


def motions_of_groups(model, seen, index, u):
    """By hand: each two observations of a clip give an initial state, whose roll-out passes all its frames."""
    motions = []
    for k in range(0, len(index), 2):
        later, earlier = both_ways(model, seen[k], seen[k + 1], u)
        motions.append([later[i - index[k]] if i >= index[k] else earlier[index[k] - i] for i in index])
    return np.asarray(motions)


def track_clip(path, index, u):
    index = jnp.array(index)
    return Clip(None, path[None, index], index[None], u[None], DT[None], u.shape[0])


@eqx.filter_jit
def track(model, clip):
    return TrackLoss(scale=0.1)(model, clip, key=jax.random.key(0), step=jnp.array(0))[0]


@pytest.mark.parametrize(("loss", "index", "span"), [(VisionLoss(), [0], 1), (PredictionLoss(), [0, 1, 4, 5], 8)])
def test_every_parameter_a_loss_should_move_gets_a_gradient(loss, index, span, getkey):
    model = fast(width=8).build(SCENE, jax.random.key(0))
    clip = clips(getkey(), 3, index, span)
    gradient = eqx.filter_jit(eqx.filter_grad(lambda m: loss(m, clip, key=getkey(), step=jnp.array(5))[0]))(model)
    groups = {name: jax.tree.leaves(getattr(gradient, name)) for name in ("estimator", "dynamics", "renderer")}
    moved = {name: any(bool(jnp.any(leaf != 0)) for leaf in leaves) for name, leaves in groups.items()}
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaves in groups.values() for leaf in leaves)
    expected = {
        VisionLoss: {"estimator": True, "dynamics": False, "renderer": True},
        PredictionLoss: {"estimator": True, "dynamics": True, "renderer": True},
    }[type(loss)]
    assert moved == expected


@pytest.mark.parametrize(
    ("item", "weights"),
    [(DistanceToPoint("a"), (100.0, 325.0, 1000.0, 1000.0)), (FixedDistance("a", "b"), (1.0, 31.6, 1000.0, 1000.0))],
)
def test_the_weights_of_constraints_grow_with_the_steps(item, weights, getkey):
    """On one keypoint from the first step, between keypoints later: 1000^(1/2) = 31.6 at a quarter of the steps."""
    model = fast(Constraints(("a", "b"), (item,)), width=8).build(SCENE, jax.random.key(0))
    # Keypoints that differ between pictures; otherwise the term would be smaller than rounding errors.
    model = eqx.tree_at(lambda m: m.estimator.network.out.kernel, model, replace_fn=lambda kernel: 100 * kernel)
    clip = clips(getkey(), 3, [0], 1)
    loss = eqx.filter_jit(VisionLoss(constraint=(100.0, 1000.0), coupling=1.0, patches=(0.0, 0.0), steps=100.0))
    for step, weight in zip((0, 25, 100, 200), weights, strict=True):
        total, terms = loss(model, clip, key=getkey(), step=jnp.array(step))
        rest = total - terms["reconstruction"] - terms["heat_map"]
        assert float(rest / terms["constraint"]) == pytest.approx(weight, rel=0.02), terms


def test_patches_count_after_the_keypoints_have_found_their_parts_and_before_their_constraints_are_exact(getkey):
    model = fast(Constraints(("a", "b"), ()), width=8).build(SCENE, jax.random.key(0))
    clip = clips(getkey(), 3, [0], 1)
    loss = eqx.filter_jit(VisionLoss(patches=(2.0, 0.5), steps=100.0))
    for step, weight in ((0, 0.0), (10, 0.0), (35, 2.0), (70, 0.5), (200, 0.5)):
        total, terms = loss(model, clip, key=getkey(), step=jnp.array(step))
        rest = total - terms["reconstruction"] - terms["heat_map"]
        assert float(rest) == pytest.approx(weight * float(terms["patches"]), abs=1e-3), step


def test_constraints_between_keypoints_move_the_joint_first(getkey):
    """Of an acrobot: the forearm's length moves the elbow from the first step, the forearm's end only later."""
    items = (DistanceToPoint("elbow"), FixedDistance("elbow", "end"))
    model = fast(Constraints(("elbow", "end"), items), width=8).build(SCENE, jax.random.key(0))
    clip = clips(getkey(), 3, [0], 1)
    loss = VisionLoss(joints=0.85, patches=(0.0, 0.0), steps=100.0)

    @eqx.filter_jit
    @eqx.filter_grad
    def push(model, step):
        total, terms = loss(model, clip, key=jax.random.key(0), step=step)
        return total - terms["reconstruction"] - terms["heat_map"]

    for step, end_moves in ((0, False), (84, False), (86, True)):
        kernel = push(model, jnp.array(step)).estimator.network.out.kernel
        elbow, end = (bool(jnp.any(jnp.abs(kernel[..., k]) > 1e-6 * jnp.abs(kernel).max())) for k in (0, 1))
        assert (elbow, end) == (True, end_moves), step


def test_paper_model_predicts_with_its_adaptive_solver(paper_model, getkey):
    frames = jax.random.uniform(getkey(), (2, 16, 16, 3))
    prediction = predict(paper_model, frames, jnp.array([0.3]), 6)
    assert prediction.frames.shape == (6, 16, 16, 3)
    x = prediction.states.coordinates.x
    seen = paper_model.observe(frames[1]).keypoints.reshape(-1)
    np.testing.assert_allclose(x[1], seen, atol=1e-5)  # the state belongs to the second frame
    assert bool(jnp.all(jnp.isfinite(x)))


def test_the_initial_potential_of_the_paper_is_flat(getkey):
    """Kernels N(0, 0.01²): initial energies are near zero everywhere."""
    potential = MLPPotential(4, key=getkey())
    values = jax.vmap(potential)(jax.random.uniform(getkey(), (50, 4), minval=-1, maxval=1))
    assert float(jnp.abs(values).max()) < 1e-3


def test_coverage_pulls_a_keypoint_to_what_is_missing():
    """Of a keypoint on a disc that is rendered, and one before a disc that is not, the second is pulled there."""
    grid = image_grid(SCENE.height, SCENE.width, 1)
    discs = gaussian_maps(jnp.array([[-0.5, 0.0], [0.5, 0.0]]), grid, 0.1)
    frames, rendered = (jnp.repeat(image[None, ..., None], 3, axis=3) for image in (jnp.sum(discs, -1), discs[..., 0]))
    model = fast(Constraints(("a", "b"), ()), width=8).build(SCENE, jax.random.key(0))
    model = eqx.tree_at(lambda m: m.estimator.standardise.deviation, model, jnp.std(frames))
    force = jax.jit(
        jax.grad(lambda x, rendered: (lambda c, f: c + jnp.mean(f))(*losses._found(model, x, rendered, frames)))
    )
    pull = force(jnp.array([[[-0.5, 0.0], [0.3, 0.0]]]), rendered)[0]
    assert pull[1, 0] > 0 and jnp.abs(pull[0]).max() < 0.2 * pull[1, 0]
    # With everything rendered, keypoints are only held on what moves.
    for x, back in ((0.35, 1), (0.65, -1)):
        assert back * force(jnp.array([[[-0.5, 0.0], [x, 0.0]]]), frames)[0, 1, 0] > 0


def test_the_only_keypoint_of_a_clip_is_not_pulled_along_a_string_that_is_not_rendered_yet():
    grid = image_grid(SCENE.height, SCENE.width, 1)
    along = jnp.stack([jnp.linspace(-0.6, 0.5, 20), jnp.zeros(20)], axis=-1)
    disc = gaussian_maps(jnp.array([[0.6, 0.0]]), grid, 0.1)[..., 0]
    string = 0.2 * jnp.max(gaussian_maps(along, grid, 0.03), axis=-1)
    frames, rendered = (jnp.repeat(image[None, ..., None], 3, axis=3) for image in (disc + string, disc))
    model = fast(Constraints(("a",), (DistanceToPoint("a"),)), width=8).build(SCENE, jax.random.key(0))
    model = eqx.tree_at(lambda m: m.estimator.standardise.deviation, model, jnp.std(frames))

    def sums(x):
        return jnp.stack([jnp.sum(each) for each in losses._found(model, x, rendered, frames)])

    missing, moving = jax.jit(jax.jacobian(sums))(jnp.array([[[0.5, 0.0]]]))[:, 0, 0, 0]
    assert missing < 0 < moving
    for names, weight in ((("a",), 0), (("a", "b"), 1)):
        phi = Constraints(names, (DistanceToPoint("a"),))
        vision = config_for("keycld", "clip", constraints=phi).stages(SCENE)[0]
        assert vision.alternative.missing == weight and vision.loss.missing == 1


def test_wide_coverage_pulls_keypoints_that_are_not_the_nearest_too():
    """Of two keypoints far from a disc that is not rendered, the farther one gets a pull only while s is wide."""
    grid = image_grid(SCENE.height, SCENE.width, 1)
    disc = gaussian_maps(jnp.array([[0.7, 0.0]]), grid, 0.1)
    frames = jnp.repeat(jnp.sum(disc, -1)[None, ..., None], 3, axis=3)
    model = fast(Constraints(("a", "b"), ()), width=8).build(SCENE, jax.random.key(0))
    model = eqx.tree_at(lambda m: m.estimator.standardise.deviation, model, jnp.std(frames))
    x = jnp.array([[[-0.2, 0.0], [0.2, 0.0]]])
    force = jax.jit(jax.grad(lambda x, width: losses._found(model, x, jnp.zeros_like(frames), frames, width)[0]))
    far, near = force(x, 0.5)[0, :, 0]
    assert 0.3 * near < far < near
    far, near = force(x, 0.1)[0, :, 0]
    assert near > 0 and far < 1e-3 * near


def test_only_free_keypoints_are_held_on_the_middle_of_what_moves(getkey):
    """A constraint says where on its part a keypoint is; where none does, the centre of what moves must."""
    model = fast(Constraints(("bob", "free"), (DistanceToPoint("bob"),)), width=8).build(SCENE, jax.random.key(0))
    clip = clips(getkey(), 3, [0], 1)

    @eqx.filter_jit
    @eqx.filter_grad
    def push(model):
        held, loose = (
            VisionLoss(centre=centre)(model, clip, key=jax.random.key(0), step=jnp.array(50))[0]
            for centre in (1.0, 0.0)
        )
        return held - loose

    kernel = push(model).estimator.network.out.kernel
    assert bool(jnp.any(kernel[..., 1] != 0)) and bool(jnp.all(kernel[..., 0] == 0))
