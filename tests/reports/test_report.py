import dataclasses
import html.parser
import json
import re
import shutil

import numpy as np
import pytest
from browser import look

from keycld import KeycldError
from keycld.drawing import save_figure
from keycld.evaluation import Evaluation, Protocol, evaluate, load_evaluation, save_evaluation
from keycld.reports import write_report
from keycld.reports.figures import error_figure
from keycld.reports.movies import sheet_step
from keycld.reports.run import read_run
from swing import Swing


@pytest.fixture(scope="module")
def page(run):
    return write_report(run)


def sections(page):
    return re.findall(r'<section id="(\w+)">', page.read_text())


def test_every_part_is_there(page):
    assert sections(page) == [
        "movies", "sheets", "scores", "long", "observation", "state", "potential", "energy", "masses", "training",
        "reproduce",
    ]  # fmt: skip
    assert "is left out" not in page.read_text()


def links(page):
    return re.findall(r'<a href="#(\w+)">', page.read_text())


def test_the_contents_link_to_every_section(page):
    assert links(page) == sections(page)


def test_scores_baselines_and_command_are_on_the_page(page, scores):
    text = page.read_text()
    assert f'<p class="big">{scores["vpt"]["1"]["mean"]:.2f}</p>' in text
    for words in (
        "Valid prediction time is", "mean image", "frozen frame", "constant acceleration", "fast", "seed",
        "keycld train disc --out runs/disc", "a video determines only their ratios", "vision, joint-8",
    ):  # fmt: skip
        assert words in text, words


def test_the_page_needs_no_other_file(page):
    text = page.read_text()
    sources = re.findall(r'(?:src|href|poster)="([^"]{0,60})', text)
    assert sources and all(source.startswith(("data:", "#")) for source in sources)
    assert "url(http" not in text and "@import" not in text
    media = {path.name for path in (page.parent / "media").iterdir()}
    assert {"prediction.mp4", "prediction.gif", "sheet-1.png", "error.png", "vpt.png", "training.png"} <= media
    assert {"keypoints.png", "potential-grid.png", "potential-grid-pictures.png", "potential-rotation.png"} <= media


def test_tags_are_balanced(page):
    void, open_tags = {"meta", "link", "img", "source", "br"}, []

    class Parser(html.parser.HTMLParser):
        def handle_starttag(self, tag, attrs):
            if tag not in void:
                open_tags.append(tag)

        def handle_endtag(self, tag):
            assert open_tags.pop() == tag

    Parser().feed(page.read_text())
    assert open_tags == []


def test_a_browser_shows_every_movie_and_picture_and_requests_nothing(page, tmp_path):
    seen = look(page, tmp_path)
    assert len(seen["movies"]) == 1 + 3 + 2
    assert all(width > 100 and seconds > 0.3 for width, seconds in seen["movies"])
    assert len(seen["pictures"]) >= 3 and all(width > 0 for width in seen["pictures"])
    assert seen["requests"] == [] and seen["refused"] == [] and seen["errors"] == []
    assert seen["wider_than_window"] == []
    assert seen["movie_hidden"] is False


def test_the_gif_replaces_a_movie_that_cannot_be_played(page, tmp_path):
    broken = tmp_path / "broken.html"
    broken.write_text(re.sub(r"data:video/mp4;base64,[^\"]+", "data:video/mp4;base64,AAAA", page.read_text(), count=1))
    seen = look(broken, tmp_path)
    assert seen["movie_hidden"] is True and seen["gif_width"] > 100


def test_a_run_without_results_says_what_is_left_out(tmp_path):
    (tmp_path / "config.json").write_text(json.dumps({"system": "disc", "command": "keycld train <disc>"}))
    page = write_report(tmp_path)
    text = page.read_text()
    assert sections(page) == ["reproduce"]
    assert text.count("is left out") == 8
    assert "keycld train &lt;disc&gt;" in text


def verdict(folder, passed, *failures):
    (folder / "verdict.json").write_text(json.dumps({"passed": passed, "failures": failures}))


def test_a_training_that_failed_is_not_shown_as_a_model(run, tmp_path):
    """Even if a checkpoint of it was scored before it failed."""
    folder = shutil.copytree(run, tmp_path / "run")
    verdict(folder, False, "vision: no <parts> were found.", "vision: again.", "dynamics: no law was found.")
    page = write_report(folder)
    assert sections(page) == ["verdict", "training", "reproduce"]
    text = page.read_text()
    assert "has failed 3 times" in text and "<li>vision: no &lt;parts&gt; were found.</li>" in text
    assert 'class="big"' not in text and "<video" not in text


def test_a_training_that_began_again_says_so(run, tmp_path):
    folder = shutil.copytree(run, tmp_path / "run")
    verdict(folder, True, "vision: no parts were found.")
    text = write_report(folder).read_text()
    assert "It began again with other initial weights: vision: no parts were found." in text and 'class="big"' in text


def test_results_of_a_model_without_keypoints_make_a_page(plain_run):
    page = write_report(plain_run)
    assert sections(page) == links(page) == ["movies", "sheets", "scores", "reproduce"]
    assert "heat" not in re.sub(r"data:[^\"]+", "", page.read_text())


def test_a_backward_result_does_not_hide_the_energies(run, data, tmp_path):
    folder = shutil.copytree(run, tmp_path / "run")
    backward = Protocol("long@20-backward", "test_long", 20, direction="backward", shown=2)
    save_evaluation(folder, backward.name, evaluate(Swing.right(), data, backward))
    page = write_report(folder)
    assert "energy" in sections(page)
    # Rows of equal length are told apart.
    longer = page.read_text().split('id="long"')[1].split("</section>")[0]
    assert longer.count("<b>long@20-backward</b>") == 1


def test_a_result_on_other_data_is_not_the_headline(run):
    """Even if its recordings are the shortest."""
    found = read_run(run)
    own = found.evaluations["test@14"]
    other = Evaluation({**own.scores, "protocol": {**own.scores["protocol"], "name": "test@10"}}, own.arrays)
    found = dataclasses.replace(found, evaluations={"test@10-mine": other, **found.evaluations})
    assert found.headline is own


def test_energy_may_be_lost_by_friction(page):
    assert "Without input only friction should change the sum" in page.read_text()


def test_errors_far_above_the_threshold_fit_the_figure(run, tmp_path):
    folder = shutil.copytree(run, tmp_path / "run")
    result = load_evaluation(folder, "test@14")
    save_evaluation(folder, "test@14", Evaluation(result.scores, result.arrays | {"mse": 1e3 + result.arrays["mse"]}))
    # matplotlib warns of a label outside of the figure, and a warning is an error here.
    assert "scores" in sections(write_report(folder))


def test_an_incomplete_line_of_metrics_is_skipped(run):
    with (run / "metrics.jsonl").open("a") as file:
        file.write('{"step": 99, "sta')
    assert "training" in sections(write_report(run))


def test_what_is_no_run_folder_is_refused(tmp_path):
    with pytest.raises(KeycldError, match="no config.json"):
        write_report(tmp_path)
    (tmp_path / "config.json").write_text("{")
    with pytest.raises(KeycldError, match="is damaged"):
        write_report(tmp_path)


@pytest.mark.parametrize(("length", "stride", "step"), [(50, 1, 6), (256, 2, 12), (5, 1, 6)])
def test_a_sheet_says_how_many_frames_lie_between_its_pictures(length, stride, step):
    """Of long predictions every second frame is stored; of few frames there is one picture."""
    assert sheet_step(np.arange(0, length, stride)) == step


@pytest.mark.parametrize("threshold", [0.0, -1e-19])
def test_errors_are_plotted_where_nothing_moves_in_the_validation_recordings(run, tmp_path, threshold):
    """ε is then zero up to rounding, which a logarithmic axis does not have."""
    result = load_evaluation(run, "test@14")
    still = Evaluation({**result.scores, "epsilon": threshold, "threshold": threshold}, result.arrays)
    save_figure(tmp_path / "error.png", error_figure(still))
    assert (tmp_path / "error.png").exists()
