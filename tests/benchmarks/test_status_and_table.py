"""States of experiments, and the arithmetic of the tables."""

import csv
import io
import re

import pytest
from bench_stub import record

from keycld import KeycldError
from keycld.benchmarks import (
    Place,
    as_csv,
    as_markdown,
    as_text,
    over_seeds,
    provenance,
    status_of,
    status_table,
    suite_named,
    tables,
)
from keycld.benchmarks.experiment import Experiment
from keycld.benchmarks.results import Result, read_json, write_json


@pytest.fixture
def place(tmp_path):
    return Place(tmp_path, tmp_path / "results")


def select(**choice):
    return suite_named("keycld").select(**choice)


def test_the_suites():
    """Three systems, four models, three seeds; and the eight configurations of the journal version."""
    names = [experiment.name for experiment in select()]
    assert len(names) == len(set(names)) == 36
    assert names[:4] == ["pendulum-keycld-0", "cartpole-keycld-0", "acrobot-keycld-0", "pendulum-keycld-nc-0"]
    eight = suite_named("keycld-2024").select()
    assert [experiment.data.folder for experiment in eight] == [
        "pendulum-2024-none", "pendulum-2024-full",
        "cartpole-2024-none", "cartpole-2024-under", "cartpole-2024-full",
        "acrobot-2024-none", "acrobot-2024-under", "acrobot-2024-full",
    ]  # fmt: skip
    assert {protocol.given for experiment in eight for protocol in experiment.protocols} == {3}
    assert {experiment.data.folder for experiment in select()} == {"pendulum", "cartpole", "acrobot"}


def test_an_experiment_is_the_same_after_a_round_trip_through_json():
    (experiment,) = select(only="acrobot-fc-2", settings={"joint.horizons": [8, 16]})
    assert Experiment.from_json(experiment.to_json()) == experiment


def test_the_hash_depends_on_all_that_determines_the_outcome():
    (first,) = select(only="pendulum-keycld-0", seeds=[0], models=["keycld"])
    others = [
        *select(only="pendulum-keycld-1", models=["keycld"]),
        *select(only="cartpole-keycld-0", models=["keycld"]),
        *select(only="pendulum-fc-0"),
        *select(only="pendulum-keycld-0", models=["keycld"], settings={"joint.steps": 7}),
        *suite_named("keycld-2024").select(only="pendulum-full"),
    ]
    assert len({experiment.hash() for experiment in (first, *others)}) == 1 + len(others)
    # A setting with the value of the preset changes nothing.
    same = first.config().settings()["joint"]["steps"]
    (same_as_preset,) = select(only="pendulum-keycld-0", models=["keycld"], settings={"joint.steps": same})
    assert same_as_preset.hash() == first.hash()


def test_stale_results(place):
    (experiment,) = select(only="pendulum-keycld-0", models=["keycld"])
    assert status_of(experiment, place).word == "missing"
    result = record(experiment, place, 0.9)
    assert status_of(experiment, place).word == "done"
    write_json(place.result(experiment), {**result, "config_hash": "0" * 16})
    assert status_of(experiment, place)[:2] == ("stale", "recorded for another configuration")
    fewer = {name: scores for name, scores in result["scores"].items() if name != "test_long@500"}
    write_json(place.result(experiment), {**result, "scores": fewer})
    assert status_of(experiment, place)[:2] == ("stale", "recorded for other protocols")
    place.result(experiment).write_text('{"half": ')
    found = status_of(experiment, place)
    assert found.word == "missing" and "damaged" in found.detail
    place.result(experiment).unlink()
    place.failure(experiment).write_text('{"half": ')
    found = status_of(experiment, place)
    assert found.word == "missing" and "failed.json is damaged" in found.detail


def test_a_result_holds_its_command_commit_and_hashes(place):
    (experiment,) = select(only="cartpole-node2-1")
    result = record(experiment, place, 0.5)
    assert result["command"].startswith("keycld bench run keycld --only cartpole-node2-1 --seeds 1 --models node2")
    assert result["commit"] == "c0ffee" and len(result["config_hash"]) == len(result["data_hash"]) == 16
    assert result["scores"]["test@50"]["baselines"]["frozen frame"] == {"1": 0.2, "0.25": 0.2}
    assert "frames" not in result["scores"]["test@50"]["vpt"]["1"]
    curve = result["curves"]["test_long@500"]
    assert len(curve["frame"]) == 50 and curve["frame"][-1] == 499
    assert curve["low"][0] < curve["mean"][0] < curve["high"][0] and curve["mean"][0] == pytest.approx(1.25e-5)
    assert read_json(place.result(experiment), Result) == result
    assert place.result(experiment).stat().st_size < 16_000


def test_mean_and_spread_over_seeds():
    assert over_seeds([0.8, 0.9, 1.0]) == pytest.approx((0.9, 0.1, 3))  # deviations −0.1, 0, 0.1: √(0.02 / 2)
    assert over_seeds([0.25]) == (0.25, None, 1)


def test_the_table(place):
    chosen = select(models=["keycld", "fc"], systems=["pendulum", "acrobot"])
    by_name = {experiment.name: experiment for experiment in chosen}
    for seed, vpt in ((0, 0.8), (1, 0.9), (2, 1.0)):
        record(by_name[f"pendulum-keycld-{seed}"], place, vpt, seconds=60.0 * (seed + 1))
    record(by_name["acrobot-keycld-0"], place, 0.5)
    stale = record(by_name["acrobot-keycld-1"], place, 0.1)
    write_json(place.result(by_name["acrobot-keycld-1"]), {**stale, "config_hash": "old"})

    found = {table.name: table for table in tables(chosen, place)}
    assert list(found) == [
        "test@50", "test@50 ε/4", "validation@50", "validation@50 ε/4",
        "test_long@200", "test_long@200 ε/4", "test_long@500", "test_long@500 ε/4", "minutes",
    ]  # fmt: skip
    table = found["test@50"]
    assert table.columns == ("pendulum", "acrobot")
    lines = [re.split(r"\s{2,}", line) for line in as_text(table).splitlines()[2:]]
    values = {name: cells for name, *cells in lines}
    assert values["KeyCLD"] == ["0.900 ± 0.100 (3)", "0.500 (1)"]
    assert values["FC"] == ["–", "–"]
    assert values["mean image"] == ["0.200", "0.200"]
    assert values["paper: KeyCLD"] == ["0.38", "1.00"] and values["paper: NODE2"] == ["0.12", "0.44"]
    assert not any("paper" in row.name for row in found["test_long@200"].rows)
    assert found["minutes"].rows[0].cells[0] == pytest.approx((2.0, 1.0, 3))
    for seed, commit in ((0, "1234567890"), (1, "abcdef0123"), (2, "abcdef0123")):
        path = place.result(by_name[f"pendulum-keycld-{seed}"])
        write_json(path, {**read_json(path, Result), "commit_scored": commit})
    origin = provenance([each for each in chosen if each.data.system == "pendulum"], place)
    assert origin.endswith(": KeyCLD 1234567 (1), abcdef0 (2)")
    assert provenance(chosen, Place(place.root, place.root / "empty")) == ""
    assert "| KeyCLD | 0.900 ± 0.100 (3) | 0.500 (1) |" in as_markdown(table)
    rows = list(csv.DictReader(io.StringIO(as_csv(tuple(found.values())))))
    (cell,) = (row for row in rows if (row["table"], row["row"], row["column"]) == ("test@50", "KeyCLD", "pendulum"))
    assert float(cell["mean"]) == pytest.approx(0.9) and cell["n"] == "3"

    text = status_table(chosen, place)
    assert "pendulum-keycld-1  done     0.900      2.0" in text
    assert "acrobot-keycld-1   stale" in text and "acrobot-fc-2       missing" in text


def test_laws_have_tables_where_they_were_measured(place):
    chosen = suite_named("zoo").select(only="damped", seeds=(0, 1))
    by_name = {experiment.name: experiment for experiment in chosen}
    for seed, found in ((0, 0.15), (1, 0.17)):
        experiment = by_name[f"zoo/damped_pendulum-keycld-{seed}"]
        result = record(experiment, place, 1.0)
        result["scores"]["test@50"]["state"] = {"acceleration": 0.01, "friction": {"found": found, "true": 0.154}}
        write_json(place.result(experiment), result)
    tables_by_name = {table.name: table for table in tables(chosen, place)}
    values = {row.name: tables_by_name["friction"].texts(row) for row in tables_by_name["friction"].rows}
    assert list(tables_by_name["friction"].columns) == ["zoo/damped_double_pendulum", "zoo/damped_pendulum"]
    assert values == {"KeyCLD": ["–", "0.160 ± 0.014 (2)"], "true": ["–", "0.154"]}
    assert tables_by_name["acceleration"].rows[0].cells[1] == pytest.approx((0.01, 0.0, 2))


def test_the_journal_version_has_no_published_rows(place):
    chosen = suite_named("keycld-2024").select(only="cartpole")
    record(chosen[0], place, 0.9)
    table = tables(chosen, place)[0]
    assert table.columns == ("cartpole-none", "cartpole-under", "cartpole-full")
    assert [row.kind for row in table.rows] == ["ours", "trivial", "trivial"]


@pytest.mark.parametrize(
    ("choice", "words"),
    [
        ({"models": ["nod2"]}, "did you mean 'node2'"),
        ({"systems": ["pendlum"]}, "did you mean 'pendulum'"),
        ({"preset": "fats"}, "did you mean 'fast'"),
        ({"preset": "journal"}, "predicts from 3 frames, but the suite keycld gives 2"),
        ({"settings": {"joint.step": 3}}, "did you mean 'joint.steps'"),
        ({"only": "acrobot-node3-0"}, "did you mean 'acrobot-node2-0'"),
        ({"models": ["keycld", "hgn"]}, "hgn with preset 'fast' predicts from 5 frames, but the suite keycld gives 2"),
        ({"models": ["keycld", "hgn"], "preset": "control"}, "control"),
    ],
)
def test_mistakes_name_the_nearest_choice(choice, words):
    with pytest.raises(KeycldError, match=words):
        select(**choice)
