"""The scoreboard of "Which priors matter?": its suite, published numbers, ranks, tables and page."""

import json

import numpy as np
import pytest
from bench_stub import fake_evaluation, record

from keycld._errors import KeycldError
from keycld.benchmarks import (
    Place,
    as_csv,
    as_markdown,
    as_text,
    average_ranks,
    boards,
    cost_figure,
    illustrate_priors,
    suite_named,
    tables,
)
from keycld.benchmarks.experiment import Experiment
from keycld.benchmarks.published_priors import PRIORS_TITLES, PUBLISHED
from keycld.benchmarks.results import command, record_failure, write_json
from keycld.benchmarks.scoreboard import winners
from keycld.evaluation import make_protocol, protocol_named, with_given
from keycld.reports import write_priors_report

TWO = ["toy/mass_spring", "toy/two_body"]


@pytest.fixture
def place(tmp_path):
    return Place(tmp_path, tmp_path / "results")


def select(**choice):
    return suite_named("priors").select(**{"systems": TWO, "models": ["hgn", "rgn", "ar"], **choice})


def scored(experiment, place, forward, backward=0.0, error=1.0):
    """A recorded result with these scores; the constant picture has VPT 0.2 and an error of 100."""
    result = record(experiment, place, forward)
    for name, scores in result["scores"].items():
        if name.endswith("backward"):
            next(iter(scores["vpt"].values()))["mean"] = backward
        scores["table_units"] = {"train": error, "extrapolation": 2 * error}
        scores["baselines"]["mean image"]["table_units"] = {"train": 100.0, "extrapolation": 100.0}
    write_json(place.result(experiment), result)


def test_the_suite_is_every_model_on_every_set():
    experiments = suite_named("priors").select()
    assert len(experiments) == 7 * 17 + 11
    assert list(dict.fromkeys(each.model for each in experiments)) == [*PRIORS_TITLES, "keycld"]
    assert {each.data.folder for each in experiments} >= {"toy/mass_spring-2000-200", "md/lj_4-2100-200"}
    assert Experiment.from_json(experiments[0].to_json()) == experiments[0]


def test_keycld_learns_the_sets_whose_discs_have_names(place):
    """One keypoint a disc; the others stay on the board with what they lack."""
    systems = ["toy/pendulum", "toy/double_pendulum", "toy/two_body", "games/matching_pennies"]
    experiments = select(systems=systems, models=["hgn", "keycld"])
    constraints = {each.data.label: each.config().phi for each in experiments if each.model == "keycld"}
    assert {label: (len(phi.keypoints), len(phi.items)) for label, phi in constraints.items()} == {
        "toy/pendulum": (1, 1),
        "toy/double_pendulum": (2, 2),
        "toy/two_body": (2, 0),
    }
    assert "test@256-priors-backward" in {protocol.name for protocol in experiments[-1].protocols}
    (board, *_) = boards(experiments, place)
    assert board.notes["games/matching_pennies", "keycld"] == "no keypoints"
    assert board.notes["games/matching_pennies", "hgn"] == board.notes["toy/two_body", "keycld"] == "missing"
    with pytest.raises(KeycldError, match="keycld cannot learn games/matching_pennies: no keypoints"):
        select(systems=systems[-1:], models=["keycld"])


def test_each_model_and_set_has_the_protocols_that_it_can_have():
    """Only reversible models are scored backward, only six sets have long recordings; given frames are as needed."""
    protocols = {(each.model, each.data.label): {p.name for p in each.protocols} for each in select()}
    assert "test@256-priors-backward" in protocols["hgn", "toy/two_body"]
    assert not any("backward" in name for name in protocols["rgn", "toy/two_body"] | protocols["ar", "toy/two_body"])
    assert "test_long@1000-priors" in protocols["rgn", "toy/mass_spring"] - protocols["rgn", "toy/two_body"]
    (original, *_) = select(models=["hgn"], preset="original")
    assert {protocol.given for protocol in original.protocols} == {31}


def test_a_protocol_of_more_trajectories_has_a_name():
    protocol = protocol_named("test@256-priors-of-200-backward")
    assert protocol.trajectories == 200 and protocol.backward
    assert protocol_named("test@256-priors").trajectories == 20
    assert make_protocol("test", 50, trajectories=7).name == "test@50-of-7"
    assert with_given(protocol, 7).name == "test@256-priors-given-7-of-200-backward"


def test_published_tables_are_complete():
    """All 17 sets; N/A in four cells, one of them backward. ODE[TR] is best or equal in 7 forward, 11 backward.

    The paper says 11 and 13 of 17, of scores with more digits.
    """
    counts = {"forward": 119 - 4, "backward": 68 - 1, "reconstruction": 119 - 4, "extrapolation": 119 - 4}
    for name, table in PUBLISHED.items():
        assert len(table.scores) == 17
        assert sum(map(len, table.scores.values())) == counts[name]
    for name, times in (("forward", 7), ("backward", 11)):
        best = [winners(scores, larger=True) for scores in PUBLISHED[name].scores.values()]
        assert sum("ode-tr" in models for models in best) == times


def test_average_ranks_are_near_the_published_ones():
    """The paper's are of scores with more digits, which decide between equal printed ones.

    In Tables 5 and 6 it counts an N/A as rank 1: there its models with N/A are left out.
    """
    for name, table in PUBLISHED.items():
        found = average_ranks(table.scores, list(table.ranks), larger=table.larger)
        sets = table.scores.values()
        complete = [model for model in table.ranks if table.larger or all(model in each for each in sets)]
        assert len(complete) >= 4
        for model in complete:
            assert found[model] == pytest.approx(table.ranks[model], abs=0.26), (name, model)
    two = {"a": {"x": 1.0, "y": 1.0}, "b": {"x": 2.0}}
    assert average_ranks(two, ["x", "y"], larger=True) == {"x": 1.25, "y": 1.75}


def test_the_board_shows_ours_published_and_winners(place):
    for experiment in select():
        forward = {"hgn": 0.9, "rgn": 0.4, "ar": 0.9}[experiment.model]
        scored(experiment, place, forward, backward=0.3, error={"hgn": 0.1, "rgn": 5.0, "ar": 7.0}[experiment.model])
    found = {table.name: table for table in tables(select(), place)}
    assert list(found) == ["forward", "backward", "reconstruction", "extrapolation"]
    forward, backward = found["forward"], found["backward"]
    assert forward.columns == ("HGN", "RGN", "AR", "mean image")
    ours, paper = forward.rows[:2]
    assert [cell.mean for cell in ours.cells] == [0.9, 0.4, 0.9, 0.2]
    assert ours.note == "best HGN, AR"
    assert [cell and cell.mean for cell in paper.cells] == [1.0, 0.59, 0.2, None] and paper.note == "best HGN"
    assert [cell and cell.mean for cell in backward.rows[0].cells] == [0.3, None, None, 0.2]
    assert found["reconstruction"].rows[0].note == found["extrapolation"].rows[0].note == "best HGN"
    assert found["extrapolation"].rows[0].cells[1].mean == 10.0
    ranks = forward.rows[-2]
    assert ranks.name == "average rank" and [cell and cell.mean for cell in ranks.cells] == [1.5, 3.0, 1.5, None]
    assert "best HGN, AR" in as_text(forward) and "best HGN, AR |" in as_markdown(forward)
    assert "forward,toy/mass_spring,ours,HGN,0.9,,1" in as_csv([forward])


def test_nothing_is_dropped(place):
    """A failure shows its kind, an experiment that has not run its state, an error that is not finite that it is so."""
    hgn, rgn, ar = select(systems=TWO[:1])
    record_failure(hgn, place, "training", "KeycldError", "not a finite number at step 3")
    scored(ar, place, 0.1)
    result = json.loads(place.result(ar).read_text())
    result["scores"]["test@124-priors"]["table_units"]["train"] = None
    write_json(place.result(ar), result)
    by_name = {board.measure.name: board for board in boards(select(systems=TWO[:1]), place)}
    assert by_name["forward"].notes == {
        ("toy/mass_spring", "hgn"): "failed KeycldError",
        ("toy/mass_spring", "rgn"): "missing",
    }
    assert by_name["reconstruction"].notes["toy/mass_spring", "ar"] == "not finite"
    (table, *_) = tables(select(systems=TWO[:1]), place)
    assert table.rows[0].note == "best AR; failed KeycldError: HGN; missing: RGN"
    assert rgn.name == "toy/mass_spring-rgn-0"


def test_ranks_are_of_sets_that_have_ended(place):
    """A score that is not there yet is not a bad one; a failure is."""
    (hgn, rgn, ar), later = select(systems=TWO[:1]), select(systems=TWO[1:])
    scored(hgn, place, 0.1)
    record_failure(rgn, place, "training", "KeycldError", "not a finite number at step 3")
    scored(ar, place, 0.2)
    scored(later[0], place, 0.9)
    ranks = tables(select(), place)[0].rows[-2]
    assert [cell and cell.mean for cell in ranks.cells] == [2.0, 3.0, 1.0, None]
    assert ranks.note == "over 1 of 2 sets, the others are unfinished"
    for each in later:
        scored(each, place, 0.9)
    ranks = tables(select(), place)[0].rows[-2]
    assert [cell and cell.mean for cell in ranks.cells] == [2.0, 2.5, 1.5, None] and ranks.note == ""


def test_a_seed_that_failed_is_not_hidden_by_the_next_one(place):
    failed, short, shorter = select(systems=TWO[:1], models=["hgn"], seeds=[0, 1, 2])
    record_failure(failed, place, "training", "KeycldError", "not a finite number at step 3")
    for experiment, share in ((short, 0.9), (shorter, 0.3)):
        scored(experiment, place, 0.5)
        write_json(place.result(experiment), {**json.loads(place.result(experiment).read_text()), "share": share})
    (board, *_) = boards([failed, short, shorter], place)
    assert board.notes == {("toy/mass_spring", "hgn"): "failed KeycldError, 90% of the steps, 30% of the steps"}


def test_more_given_frames_are_marked(place):
    (original,) = select(systems=TWO[:1], models=["hgn"], preset="original")
    scored(original, place, 0.5)
    (board, *_) = boards([original], place)
    assert board.notes == {("toy/mass_spring", "hgn"): "31 frames given"}


def test_the_page_has_heat_maps_roll_outs_and_what_is_missing(place):
    hgn, rgn, _ = select(systems=TWO[:1])
    scored(hgn, place, 0.9, error=1.0)
    record_failure(rgn, place, "training", "SIGKILL", "memory")
    page = write_priors_report(select(systems=TWO[:1]), place, place.root / "page").read_text()
    assert "rgb(42 120 142 / 0.68)" in page  # 0.75 of a VPT of 0.9
    assert "<small>failed SIGKILL</small>" in page and "<small>missing</small>" in page
    assert page.count("Frames of toy/mass_spring") == 2  # forward and backward
    assert "minutes of training" in page and "A point for each set and seed." in page
    assert fake_evaluation(hgn.protocols[0], 0.5).scores["metric"] == "normalised"


def test_figures_are_sheets_movies_and_cost(place):
    """Of each direction that a model has; a suite without results has none."""
    hgn, rgn = select(systems=TWO[:1], models=["hgn", "rgn"])
    with pytest.raises(KeycldError, match="nothing to plot"):
        illustrate_priors([hgn, rgn], place, place.root / "media")
    scored(hgn, place, 0.9)
    scored(rgn, place, 0.2)
    written = illustrate_priors([hgn, rgn], place, place.root / "media")
    names = [path.name for path in written if path.suffix == ".png"]
    assert names == [
        "cost.png",
        "sheet-toy-mass_spring-test@256-priors.png",
        "sheet-toy-mass_spring-test@256-priors-backward.png",
    ]
    assert all(path.exists() for path in written) and len(written) == 1 + 2 * 3
    panels = cost_figure([hgn, rgn], place).axes
    assert [axes.get_title(loc="left") for axes in panels] == ["HGN", "RGN"]
    (points,) = panels[0].lines
    np.testing.assert_allclose(points.get_xydata(), [[1.0, 0.9]])


def test_shortened_trainings_are_marked(place):
    (hgn,) = select(systems=TWO[:1], models=["hgn"], minutes=20.0)
    assert hgn.group == "priors/fast-20min" and "--minutes 20" in command(hgn)
    assert Experiment.from_json(hgn.to_json()) == hgn and hgn.hash() != select(models=["hgn"])[0].hash()
    scored(hgn, place, 0.5)
    result = json.loads(place.result(hgn).read_text())
    assert result["minutes"] is None and result["training"]["step"] > 0  # those of the stub's training
    write_json(place.result(hgn), {**result, "minutes": 20.0, "share": 0.44})
    (table, *_) = tables([hgn], place)
    assert table.rows[0].note == "best HGN; 44% of the steps: HGN" and "shortened to 20 minutes" in table.title
    with pytest.raises(KeycldError, match="--minutes is a positive number, not 0"):
        select(minutes=0.0)
