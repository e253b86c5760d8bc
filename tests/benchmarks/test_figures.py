"""Figures, sheets, movies and the page of a suite, from made-up results."""

import re
import shutil
import subprocess

import imageio.v3
import imageio_ffmpeg
import numpy as np
import pytest
from bench_stub import record
from matplotlib.colors import to_hex

from keycld import KeycldError
from keycld.benchmarks import (
    Place,
    control_strip,
    error_figure,
    illustrate,
    observation_sheet,
    potential_figures,
    suite_named,
)
from keycld.benchmarks.results import write_json
from keycld.drawing import INK, KEYPOINT_COLOURS
from keycld.evaluation import Evaluation, load_evaluation, save_evaluation
from keycld.reports import write_suite_report

ANGLE = np.linspace(-np.pi, np.pi, 33)
SETTLED = 24


def pendulum_sweeps(factor=1.0):
    """V = factor · cos(angle), and 1 % of it along a second path: a pendulum on a cart, from made-up pictures."""
    arrays = {
        "names": np.array(["rotation", "cart"]),
        "vary": np.array(["angle", "position"]),
        "units": np.array(["rad", "m"]),
    }
    for name, values, part in (("rotation", ANGLE, 1.0), ("cart", ANGLE / np.pi, 0.01)):
        arrays |= {
            f"{name}/values": values[:, None],
            f"{name}/shape": np.array([33]),
            f"{name}/potential": part * factor * np.cos(ANGLE),
            f"{name}/keypoints": 0.6 * np.stack([np.sin(ANGLE), np.cos(ANGLE)], axis=-1)[:, None].astype(np.float32),
            f"{name}/image": np.full((33, 16, 16, 3), 90, np.uint8),
        }
    return arrays


def seen(truth):
    """A keypoint in the upper right quarter of every frame, and its heat map."""
    count, frames = truth.shape[:2]
    maps = np.zeros((count, frames, 1, 16, 16), np.uint8)
    maps[..., 3, 12] = 255
    return {"observed_keypoints": np.full((count, frames, 1, 2), 0.6, np.float32), "heat_maps": maps}


def closed_loop():
    """Trial of 200 frames, whose shade is the frame's number, that keeps the goal from frame SETTLED on."""
    shades = np.broadcast_to(np.arange(201, dtype=np.uint8)[:, None, None, None], (201, 16, 16, 3))
    step = {"median_ms": 1.0, "p99_ms": 1.0, "period_ms": 20.0, "missed": 0, "frames": 200}
    scores = {
        "law": "paper", "dt": 0.02, "settled_seconds": [0.02 * SETTLED], "n": 1, "successes": 1, "limit": None,
        "estimator": "predict-correct", "disturbance": {"noise": 0.0, "dropped": 0.0}, "goal": "upright",
        "inputs": ["torque"], "acting": ["torque"], "largest_input": [1.0], "mean_mass": 1.0, "step": step,
    }  # fmt: skip
    arrays = {
        "frames": shades, "goal_frame": np.full((16, 16, 3), 250, np.uint8), "x": np.zeros((1, 200, 2)),
        "good": np.zeros((1, 200), bool), "input": np.zeros((1, 200, 1)), "tilts": np.zeros((1, 201, 1)),
    }  # fmt: skip
    return Evaluation(scores, arrays)


def select(**choice):
    return suite_named("keycld").select(systems=["pendulum"], **choice)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """KeyCLD with two seeds, the second with twice the error, and FC with one."""
    folder = tmp_path_factory.mktemp("suite")
    place = Place(folder, folder / "results")
    for experiment in (*select(models=["keycld"], seeds=[0, 1]), *select(models=["fc"], seeds=[0])):
        result = record(experiment, place, 0.9)
        for curve in result["curves"].values():
            factor = 1 + experiment.seed
            curve |= {name: [factor * value for value in curve[name]] for name in ("mean", "low", "high")}
        write_json(place.result(experiment), result)
    run = place.run(select(models=["keycld"], seeds=[0])[0])
    result = load_evaluation(run, "test@50")
    save_evaluation(run, "test@50", Evaluation(result.scores, result.arrays | seen(result.arrays["truth"])))
    save_evaluation(run, "sweeps", Evaluation({}, pendulum_sweeps()))
    save_evaluation(run, "control-upright-paper", closed_loop())
    return place


def test_fig_3_is_the_mean_over_seeds(place):
    protocol = select()[0].protocols[0]
    figure = error_figure(select(), place, protocol)
    assert figure is not None
    (axes,) = figure.axes
    assert axes.get_title(loc="left") == "pendulum"
    lines = {line.get_label(): line for line in axes.get_lines()}
    frames = np.geomspace(1e-5, 1e-2, 50)
    # Trajectories have 0.5 to 2 times these errors, 1.25 on average, and the seeds 1 and 2 times those.
    np.testing.assert_allclose(lines["KeyCLD"].get_ydata(), 1.25 * 1.5 * frames, rtol=1e-3)
    np.testing.assert_allclose(lines["FC"].get_ydata(), 1.25 * frames, rtol=1e-3)
    assert to_hex(lines["FC"].get_color()) == INK.four and "NODE2" not in lines
    assert axes.get_yscale() == "log"
    assert any(np.all(np.asarray(line.get_ydata()) == 1e-3) for line in axes.get_lines())  # ε


def test_sheets_and_movies_show_truth_and_every_model(place, tmp_path):
    drawn = illustrate(select(), place, tmp_path)
    names = {path.name for path in drawn.files}
    assert {"error-test@50.png", "error-test_long@500.png"} <= names
    assert {f"{kind}-pendulum-{p}" for kind in ("sheet", "movie") for p in ("test@50", "test_long@200")} <= {
        path.stem for path in drawn.files
    }
    first = drawn.pictures[0]
    assert list(first.gallery.predictions) == ["KeyCLD", "FC"] and first.gallery.seeds == {"KeyCLD": 0, "FC": 0}
    # Valid while the first trajectory's error, half of the mean's, is below ε.
    valid = 0.5 * np.geomspace(1e-5, 1e-2, 50) <= 1e-3
    np.testing.assert_array_equal(first.gallery.valid["FC"], valid)
    sheet = imageio.v3.imread(first.sheet)
    rows, columns = 3, len(range(0, 50, 4))
    assert sheet.shape[0] >= rows * 32 and sheet.shape[1] >= columns * 32
    assert all(path.stat().st_size > 1000 for path in drawn.files)
    gif = imageio.v3.imread(first.movie.with_suffix(".gif"))
    assert gif.shape[0] == 50 + 12 and gif.shape[2] == 2 * (3 * 16 + 2 * 2)  # three panels, two gaps
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", first.movie, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    decoded = subprocess.run(command, capture_output=True, check=True).stdout
    assert len(decoded) % 62 == 0 and len(decoded) > 62 * 3 * (4 * 16) * (3 * 4 * 16)


def test_figs_1_5_and_8_show_the_first_seed_of_keycld(place, tmp_path):
    drawn = illustrate(select(), place, tmp_path).paper
    assert [figure.path.name for figure in drawn.made] == [
        "fig-1.png", "fig-5-pendulum.png", "fig-8-pendulum-rotation.png", "potential-pendulum-cart.png",
    ]  # fmt: skip
    assert all(figure.path.stat().st_size > 500 for figure in drawn.made) and drawn.left_out == ()
    assert drawn.made[2].title == "Fig. 8: pendulum, potential energy over angle"


def test_a_figure_without_its_results_is_left_out_with_a_sentence(place, tmp_path):
    other = Place(tmp_path, place.results)
    (experiment,) = select(models=["keycld"], seeds=[0])
    save_evaluation(other.run(experiment), "sweeps", Evaluation({}, pendulum_sweeps()))
    drawn = illustrate(select(), other, tmp_path / "out").paper
    assert [figure.path.name for figure in drawn.made] == ["fig-8-pendulum-rotation.png", "potential-pendulum-cart.png"]
    first, second = drawn.left_out
    assert first.startswith("Fig. 1 leaves out pendulum: no result 'test@50'") and "keycld eval" in first
    assert second.startswith("Fig. 5 leaves out pendulum: no closed-loop run is stored; `keycld control ")
    both = suite_named("keycld").select(systems=["pendulum", "acrobot"], models=["keycld"], seeds=[0])
    (sentence,) = (each for each in illustrate(both, place, tmp_path / "both").paper.left_out)
    assert sentence.startswith("Figs. 1, 5 and 8 to 12 leave out acrobot: no experiment with keycld is done")


def test_fig_1_shows_the_observed_keypoint_and_its_heat_map(place):
    result = load_evaluation(place.run(select(models=["keycld"], seeds=[0])[0]), "test@50")
    picture = observation_sheet([("pendulum", result, 0)], scale=3)[-48:]
    panels = [picture[:, k : k + 48] for k in picture.shape[1] - 48 - 50 * np.arange(3, -1, -1)]
    assert np.all(panels[0] == result.arrays["truth"][0, 1, 0, 0]) and np.all(panels[3] == 254)
    column, row = (7.5 + np.array([0.6, -0.6]) * 7.5 + 0.5) * 3
    np.testing.assert_array_equal(panels[1][3 * 3 + 1, 12 * 3 + 1], KEYPOINT_COLOURS[0])
    np.testing.assert_array_equal(panels[2][round(row), round(column)], KEYPOINT_COLOURS[0])


def test_fig_5_shows_the_swing_up_then_the_end_and_the_goal():
    strip = control_strip(closed_loop(), scale=2)
    shades = strip[-1, 16::34, 0]
    expected = [*np.round(np.linspace(0, SETTLED, 8)), 200, 250]
    np.testing.assert_array_equal(shades, expected)


def test_figs_9_and_10_share_one_vertical_span_and_show_v_from_its_middle():
    rotation, cart = potential_figures(pendulum_sweeps(factor=3.0))
    curve, flat = (each.figure.axes[1].get_lines()[0] for each in (rotation, cart))
    np.testing.assert_allclose(curve.get_xdata(), np.degrees(ANGLE))
    np.testing.assert_allclose(curve.get_ydata(), 3.0 * np.cos(ANGLE), atol=1e-6)  # highest when it stands up
    assert rotation.figure.axes[1].get_ylim() == cart.figure.axes[1].get_ylim()
    assert np.ptp(np.asarray(flat.get_ydata())) < 0.02 * np.ptp(np.asarray(curve.get_ydata()))
    assert [each.figure.axes[1].get_xlabel() for each in (rotation, cart)] == ["angle, degrees", "position, m"]


@pytest.mark.slow
def test_results_alone_give_the_errors(place, tmp_path):
    bare = Place(tmp_path, tmp_path / "results")
    shutil.copytree(place.results, bare.results)
    drawn = illustrate(select(), bare, tmp_path / "out")
    assert drawn.pictures == () and len(drawn.errors) == 4
    page = write_suite_report(select(), bare, tmp_path / "page").read_text()
    assert page.count("is left out") == 2 and "8 to 12 leave out pendulum" in page and '<section id="errors">' in page


@pytest.mark.slow
def test_the_page(place, tmp_path):
    path = write_suite_report(select(), place, tmp_path)
    text = path.read_text()
    sections = ["errors", "sheets", "movies", "learned", "scores", "experiments"]
    assert re.findall(r'<section id="(\w+)">', text) == sections
    assert all(f'href="#{name}"' in text for name in sections)
    for words in (
        "0.900 ± 0.000 (2)",
        "paper: KeyCLD",
        "0.38",
        "3 of 12 done",
        "keycld bench run keycld --only",
        "Fig. 8: p",
    ):
        assert words in text, words
    assert all(source.startswith(("data:", "#")) for source in re.findall(r'(?:src|href|poster)="([^"]{0,60})', text))


def test_nothing_done_is_one_sentence(tmp_path):
    with pytest.raises(KeycldError, match="none of these experiments is done"):
        illustrate(select(), Place(tmp_path, tmp_path / "results"), tmp_path)
