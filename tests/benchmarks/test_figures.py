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
from keycld.benchmarks import Place, error_figure, illustrate, suite_named
from keycld.benchmarks.results import write_json
from keycld.drawing import INK
from keycld.reports import write_suite_report


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


def test_results_alone_give_the_errors(place, tmp_path):
    bare = Place(tmp_path, tmp_path / "results")
    shutil.copytree(place.results, bare.results)
    drawn = illustrate(select(), bare, tmp_path / "out")
    assert drawn.pictures == () and len(drawn.errors) == 4
    page = write_suite_report(select(), bare, tmp_path / "page").read_text()
    assert page.count("is left out") == 2 and '<section id="errors">' in page


def test_the_page(place, tmp_path):
    path = write_suite_report(select(), place, tmp_path)
    text = path.read_text()
    sections = ["errors", "sheets", "movies", "scores", "experiments"]
    assert re.findall(r'<section id="(\w+)">', text) == sections
    assert all(f'href="#{name}"' in text for name in sections)
    for words in ("0.900 ± 0.000 (2)", "paper: KeyCLD", "0.38", "3 of 12 done", "keycld bench run keycld --only"):
        assert words in text, words
    assert all(source.startswith(("data:", "#")) for source in re.findall(r'(?:src|href|poster)="([^"]{0,60})', text))


def test_nothing_done_is_one_sentence(tmp_path):
    with pytest.raises(KeycldError, match="none of these experiments is done"):
        illustrate(select(), Place(tmp_path, tmp_path / "results"), tmp_path)
