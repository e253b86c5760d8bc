import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest

import scenes
from keycld import KeycldError, systems
from keycld.data import DataSet, Trajectories, write
from keycld.evaluation import (
    Protocol,
    evaluate,
    evaluate_sweeps,
    load_evaluation,
    reading,
    references,
    save_evaluation,
    summary,
)
from keycld.evaluation.observing import probed_system
from keycld.evaluation.predicting import batch_size
from keycld.mechanics import ConstrainedLagrangian
from swing import RADIUS, DiscSystem, Still, Swing

PROTOCOL = Protocol("test@20", "test", 20, shown=3)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("disc")
    for k, (name, count) in enumerate((("train", 40), ("validation", 6), ("test", 7))):
        write(folder / f"{name}.h5", scenes.disc_pendulum(count, 24, seed=k))
    angle = np.linspace(-np.pi, np.pi, 24)
    image = scenes.draw(RADIUS * np.sin(angle), -RADIUS * np.cos(angle))
    write(
        folder / "sweeps.h5",
        Trajectories(
            time=scenes.DT * np.arange(24),
            input=np.zeros((1, 1), np.float32),
            image=image[None],
            state=np.stack([angle, 0 * angle], axis=-1)[None],
            parameters={
                "name": np.array(["rotation"]), "vary": np.array(["angle"]),
                "length": np.array([24]), "shape": np.array([[24, 1]]),
            },
            attributes=scenes.disc_pendulum(1, 3, seed=0).attributes,
        ),
    )  # fmt: skip
    constraints = folder / "constraints.toml"
    constraints.write_text(
        'keypoints = ["disc"]\n\n[[constraint]]\nkind = "distance_to_point"\nkeypoint = "disc"\npoint = [0.0, 0.0]\n'
    )
    return DataSet(folder, constraints)


@pytest.fixture
def known(monkeypatch):
    """Make the test's system known for one test."""
    systems.names()
    monkeypatch.setitem(systems.registry._SYSTEMS, "disc", DiscSystem())


@pytest.fixture(scope="module")
def shared(data):
    return references(data)


def test_the_true_law_predicts_to_the_end_and_beats_every_baseline(data, shared, known):
    done = []
    result = evaluate(Swing.right(), data, PROTOCOL, shared=shared, progress=lambda k, n: done.append((k, n)))
    scores = result.scores
    vpt = scores["vpt"]["1"]
    assert vpt["mean"] == 1.0 and vpt["frames"] == [20] * 7
    assert all(vpt["mean"] > 1.1 * each["vpt"]["1"]["mean"] for each in scores["baselines"].values())
    assert scores["mse"] < 0.01 * scores["epsilon"]
    assert scores["state"]["residual"] < 0.02
    assert scores["state"]["coordinates"][0]["unit"] == "deg"
    assert scores["state"]["coordinates"][0]["last_median"] < 4.0
    assert scores["drift"]["energy"]["worst"] < 0.02
    assert scores["drift"]["constraint"]["worst"] < 1e-5
    assert scores["masses"] == [1.0] and scores["keypoints"] == ["disc"]
    assert done[-1] == (7 * 20, 7 * 20)


def test_a_sum_of_a_row_of_the_mass_matrix_below_zero_is_no_mass(data, shared, known, monkeypatch, tmp_path):
    """Without constraints a matrix that couples keypoints may have one; its scores can be read again."""
    monkeypatch.setattr(ConstrainedLagrangian, "masses", property(lambda law: jnp.array([-0.5])))
    result = evaluate(Swing.right(), data, PROTOCOL, shared=shared)
    assert "masses" not in result.scores
    save_evaluation(tmp_path, PROTOCOL.name, result)
    assert load_evaluation(tmp_path, PROTOCOL.name).scores["keypoints"] == ["disc"]


def test_arrays_for_the_report(data, shared, known):
    arrays = evaluate(Swing.right(), data, PROTOCOL, shared=shared).arrays
    shapes = {name: value.shape for name, value in arrays.items()}
    assert shapes["mse"] == shapes["landmark_error"] == shapes["baseline_mse_mean_image"] == (7, 20)
    assert shapes["coordinate_error"] == (7, 20, 1)
    assert shapes["truth"] == shapes["prediction"] == (3, 20, 16, 16, 3)
    assert shapes["keypoints"] == shapes["observed_keypoints"] == (3, 20, 1, 2)
    assert shapes["heat_maps"] == (3, 20, 1, 16, 16)
    for name in ("kinetic", "potential", "deviation", "free_kinetic", "free_potential"):
        assert shapes[name] == (3, 20)
    assert arrays["prediction"].dtype == arrays["truth"].dtype == arrays["heat_maps"].dtype == np.uint8
    np.testing.assert_array_equal(arrays["truth"], data.test().image[:3, :20])
    np.testing.assert_allclose(arrays["keypoints"], arrays["observed_keypoints"], atol=0.05)


def test_weaker_gravity_scores_less(data, shared):
    right = evaluate(Swing.right(), data, PROTOCOL, shared=shared).scores
    wrong = evaluate(Swing.right(gravity=2.0), data, PROTOCOL, shared=shared).scores
    assert wrong["vpt"]["1"]["mean"] < 0.8 * right["vpt"]["1"]["mean"]
    assert wrong["vpt"]["0.25"]["mean"] <= wrong["vpt"]["1"]["mean"]


def test_a_split_without_states_has_no_probe(data, shared, known):
    class Bare(DataSet):
        def split(self, name, **choice):
            found = super().split(name, **choice)
            return dataclasses.replace(found, state=None) if name == "validation" else found

    assert probed_system(data, shared, "test") is not None
    assert probed_system(Bare(data.folder, data.folder / "constraints.toml"), shared, "test") is None


def test_only_the_given_frames_and_inputs_reach_the_model(data, shared):
    """Later pictures and all true states are spoiled; the prediction must stay the same."""

    class Spoiled(DataSet):
        def split(self, name, **choice):
            found = super().split(name, **choice)
            image = None if found.image is None else found.image.copy()
            if image is not None:
                image[:, PROTOCOL.given :] = 77
            return dataclasses.replace(found, image=image, state=0 * found.state)

    honest = evaluate(Swing.right(), data, PROTOCOL, shared=shared).arrays
    spoiled = evaluate(Swing.right(), Spoiled(data.folder, data.constraints_file), PROTOCOL, shared=shared).arrays
    np.testing.assert_array_equal(spoiled["prediction"], honest["prediction"])
    np.testing.assert_array_equal(spoiled["keypoints"], honest["keypoints"])


def test_a_model_without_keypoints_and_energies_is_scored_too(data, shared, known):
    result = evaluate(Still(), data, PROTOCOL, shared=shared)
    frozen = result.scores["baselines"]["frozen frame"]["vpt"]["1"]["mean"]
    assert result.scores["vpt"]["1"]["mean"] == pytest.approx(frozen, abs=0.1)
    assert not {"state", "drift", "masses", "keypoints"} & set(result.scores)
    assert not {"heat_maps", "kinetic", "free_kinetic"} & set(result.arrays)
    assert evaluate_sweeps(Still(), data).arrays == {}


def test_data_without_true_states_or_of_an_unknown_system_give_no_probe(data, shared):
    assert "state" not in evaluate(Swing.right(), data, PROTOCOL, shared=shared).scores


def test_input_that_changes_with_time(data, shared):
    """The same input, once constant and once written for every frame."""

    class Varying(DataSet):
        def split(self, name, **choice):
            found = super().split(name, **choice)
            u = np.repeat(found.input[:, None], found.frames, axis=1)
            return dataclasses.replace(found, input=u)

    constant = evaluate(Swing.right(), data, PROTOCOL, shared=shared).arrays
    varying = evaluate(Swing.right(), Varying(data.folder, None), PROTOCOL, shared=shared).arrays
    np.testing.assert_allclose(varying["keypoints"], constant["keypoints"], atol=1e-5)


def test_the_potential_along_a_turn_is_gravity(data):
    arrays = evaluate_sweeps(Swing.right(), data).arrays
    potential = arrays["rotation/potential"]
    expected = -9.0 * RADIUS * RADIUS * np.cos(arrays["rotation/values"][:, 0])
    np.testing.assert_allclose(potential, expected, atol=0.1)
    assert arrays["units"].tolist() == ["rad"] and arrays["rotation/keypoints"].shape == (24, 1, 2)


def test_results_survive_the_disk(data, shared, known, tmp_path):
    result = evaluate(Swing.right(), data, PROTOCOL, shared=shared)
    result.scores["odd"] = [float("nan"), np.float32(1.5)]
    path = save_evaluation(tmp_path, PROTOCOL.name, result)
    assert path == tmp_path / "evaluation" / "test@20.json"
    again = load_evaluation(tmp_path, PROTOCOL.name)
    assert again.scores["odd"] == [None, 1.5]
    assert again.scores["vpt"] == json.loads(json.dumps(result.scores["vpt"]))
    for name, value in result.arrays.items():
        np.testing.assert_array_equal(again.arrays[name], value)
    assert {p.name for p in path.parent.iterdir()} == {".lock", "test@20.json", "test@20.npz"}


def test_results_of_version_0_1_can_still_be_read(data, shared, tmp_path):
    result = evaluate(Swing.right(), data, PROTOCOL, shared=shared)
    for name in ("metric", "direction", "part", "threshold", "references"):
        del result.scores[name]
    save_evaluation(tmp_path, "old", result)
    old = load_evaluation(tmp_path, "old")
    assert old.scores["metric"] == "squared" and old.scores["part"] == [0, 20]
    assert old.valid.shape == (7, 20) and old.valid.all()


def test_a_motion_that_is_taken_up_is_scored_from_there(data, shared, known):
    """Earlier frames are neither shown nor scored, and the disc is already moving at the first given frame."""
    protocol = Protocol("test@14-from-10", "test", 14, start=10, shown=3)
    result = evaluate(Swing.right(), data, protocol, shared=shared)
    test = data.test()
    np.testing.assert_array_equal(result.arrays["truth"], test.image[:3, 10:])
    assert result.scores["vpt"]["1"]["mean"] > 0.9
    assert np.abs(test.state[:, 10, 1]).min() > 0.1

    class Spoiled(DataSet):
        def split(self, name, **choice):
            found = super().split(name, **choice)
            if found.image is not None and name == "test":
                found.image[:, :10] = 77
            return found

    spoiled = evaluate(Swing.right(), Spoiled(data.folder, data.constraints_file), protocol, shared=shared)
    np.testing.assert_array_equal(spoiled.arrays["mse"], result.arrays["mse"])
    np.testing.assert_array_equal(
        spoiled.arrays["baseline_mse_frozen_frame"], result.arrays["baseline_mse_frozen_frame"]
    )


def test_the_past_is_predicted_from_the_last_frames(data, shared, known):
    """A good law runs backward as well as forward; one that is good at first is credited for its near frames."""
    backward = Protocol("back", "test", 20, direction="backward")
    right = evaluate(Swing.right(), data, backward, shared=shared)
    assert right.scores["vpt"]["1"]["mean"] > 0.9 and right.scores["direction"] == "backward"
    assert "energy" not in right.scores["drift"]
    wrong = evaluate(Swing.right(gravity=2.0), data, backward, shared=shared)
    for errors, valid, frames in zip(wrong.errors, wrong.valid, wrong.vpt["frames"], strict=True):
        assert frames > 0 and errors[-1] <= shared.epsilon
        assert valid[20 - frames :].all() and not valid[: 20 - frames].any()
    # The frozen frame is the first of the given ones: it is right at the end of the window and wrong at its beginning.
    frozen = wrong.arrays["baseline_mse_frozen_frame"]
    np.testing.assert_array_equal(frozen[:, -2:], 0.0)
    assert frozen[:, 0].mean() > frozen[:, -3].mean()


def test_the_extrapolation_is_scored_as_in_the_second_paper(data, shared):
    """Normalised error, VPT relative to the frames from 8 on, and means over both parts in the tables' units."""
    protocol = Protocol(
        "priors", "test", 20, given=3, metric="normalised", thresholds=(0.025,), scored_from=8, trajectories=5
    )
    result = evaluate(Swing.right(gravity=4.0), data, protocol, shared=shared)
    scores, errors = result.scores, result.arrays["normalised_error"]
    assert scores["n"] == 5 and errors.shape == (5, 20) and scores["part"] == [8, 20]
    assert scores["threshold"] == 0.025
    crossed = errors[:, 8:] > 0.025
    expected = np.where(crossed.any(axis=1), crossed.argmax(axis=1), 12)
    assert scores["vpt"]["0.025"]["frames"] == expected.tolist() and 0 < expected.mean() < 12
    assert scores["vpt"]["0.025"]["mean"] == pytest.approx(expected.mean() / 12)
    assert scores["normalised_error"]["extrapolation"] == pytest.approx(errors[:, 8:].mean())
    assert scores["normalised_error"]["train"] == pytest.approx(errors[:, 2:8].mean())
    assert scores["table_units"]["train"] == pytest.approx(1e7 / 3072 * errors[:, 2:8].mean())
    assert set(scores["baselines"]["mean image"]["vpt"]) == {"0.025"}
    assert result.valid[:, :8].all()
    text = summary(scores)
    assert "VPT 0.025" in text and "frames 8 to 19 scored" in text and "tables 5 and 6" in text
    assert "–" not in text and "not finite" not in text
    scores["normalised_error"] = {"extrapolation": None}
    assert summary(scores).splitlines()[2].endswith(f"{'–':>14}{'not finite':>14}")


def test_small_blocks_change_no_number(data, shared, known, monkeypatch):
    """Training pictures of two recordings at a time, scored ones in whole batches: the same numbers."""
    whole = evaluate(Swing.right(), data, PROTOCOL, shared=shared)
    monkeypatch.setattr(reading, "_BLOCK_BYTES", 2.5 * 24 * 16 * 16 * 3)
    rows = {"train": [], "validation": [], "test": []}

    class Watched(DataSet):
        def split(self, name, *, images=True, **choice):
            found = super().split(name, images=images, **choice)
            rows[name].append(len(found) if images else 0)
            return found

    watched = Watched(data.folder, data.constraints_file)
    again = references(watched)
    blocked = evaluate(Swing.right(), watched, PROTOCOL, shared=again)
    assert max(rows["train"]) == max(rows["validation"]) == 2 and max(rows["test"]) == batch_size(20) < 7
    assert again.epsilon == shared.epsilon
    np.testing.assert_array_equal(again.mean_image, shared.mean_image)
    np.testing.assert_array_equal(again.images, shared.images)
    for name in ("baseline_mse_mean_image", "baseline_mse_frozen_frame", "baseline_mse_constant_acceleration"):
        np.testing.assert_array_equal(blocked.arrays[name], whole.arrays[name])
    np.testing.assert_array_equal(blocked.arrays["mse"], whole.arrays["mse"])
    assert blocked.scores == whole.scores


def test_the_summary_shows_the_baselines_next_to_the_model(data, shared):
    text = summary(evaluate(Swing.right(), data, PROTOCOL, shared=shared).scores)
    assert "this model" in text and "1.000" in text
    for name in ("mean image", "frozen frame", "constant acceleration"):
        assert name in text


def test_the_summary_tells_the_law_where_it_is_known(data, shared, known):
    scores = evaluate(Swing.right(), data, PROTOCOL, shared=shared).scores
    assert "law:" not in summary(scores)
    scores["state"] |= {"acceleration": 0.0123, "friction": {"found": 0.118, "true": 0.1205}}
    assert (
        "  law: acceleration 1.23 % from the true one, rms; friction takes energy at 0.118 /s (true 0.12)"
        in summary(scores)
    )
    scores["state"] |= {"acceleration": 0.0, "friction": None}
    assert summary(scores).splitlines()[-2] == "  law: acceleration 0 % from the true one, rms"


def test_what_cannot_be_scored_is_named(data, shared, tmp_path):
    with pytest.raises(KeycldError, match="scores 30 frames of test.h5, which has 24 frames"):
        evaluate(Swing.right(), data, Protocol("long", "test", 30), shared=shared)
    with pytest.raises(KeycldError, match="scores 20 frames from frame 10 on of test.h5, which has 24 frames"):
        evaluate(Swing.right(), data, Protocol("late", "test", 20, start=10), shared=shared)
    with pytest.raises(KeycldError, match="needs 2 given frames"):
        evaluate(Swing.right(), data, Protocol("one", "test", 10, given=1), shared=shared)
    with pytest.raises(KeycldError, match="'past' predicts the past, but this model cannot run backward"):
        evaluate(Still(), data, Protocol("past", "test", 10, direction="backward"), shared=shared)
    with pytest.raises(KeycldError, match="run `keycld eval`"):
        load_evaluation(tmp_path, "test@50")
    (tmp_path / "evaluation").mkdir()
    (tmp_path / "evaluation" / "test@50.json").write_text("{")
    with pytest.raises(KeycldError, match="damaged"):
        load_evaluation(tmp_path, "test@50")
