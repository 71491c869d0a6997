"""`twin.study`: The command study as a user sees it."""

from __future__ import annotations

import csv
import json
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from command_line import called

from docs import study_page

STUDY = """
title = "Short study"
scenario = "hold"
set = ["plant.kind=lagrange", "duration=0.3"]
method = "grid"
metrics = ["rms_error"]

[parameters."plant.friction.rolling_mm"]
values = [0.1, 0.2]
unit = "mm"

[[variants]]
name = "AFL"
set = ["controller.kind=afl"]

[[variants]]
name = "flung"
set = ["plant.start.x=0.34", "plant.start.x_rate=1.4"]
"""


@pytest.fixture
def study(capsys, tmp_path: Path, monkeypatch):
    """Runs the command on a short study: exit code, output, error."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.toml").write_text(STUDY)
    return partial(called, capsys, "study")


def test_a_plan_counts_the_runs_and_runs_none(study, tmp_path) -> None:
    code, out, _ = study("short.toml", "--plan", "--processes", "1")
    assert code == 0
    assert "4 runs, 4 of them left in" in out
    plan = json.loads(study("short.toml", "--plan", "--processes", "1", "--json")[1])
    assert (plan["runs"], plan["finished"], plan["left"], plan["processes"]) == (4, 0, 4, 1)
    assert not (tmp_path / "runs").exists()


def test_a_plan_for_a_cluster_counts_the_workers_it_has(study, monkeypatch) -> None:
    class Seven(ThreadPoolExecutor):
        workers = 7

    monkeypatch.setattr("twin.study.experiments.Cluster", lambda address: Seven(1))
    code, out, _ = study("short.toml", "--plan", "--scheduler", "tcp://there:8786")
    assert code == 0
    assert "on 7 processors" in " ".join(out.split())


@pytest.mark.long
def test_report_pictures_and_data_are_written(study, tmp_path) -> None:
    code, out, err = study("short.toml", "--processes", "1")
    assert code == 0
    assert "Short study: 0 of 4 runs ..." in err
    assert "flung: 2 of 2 runs did not finish" in " ".join(out.split())
    # the table of variant by parameter is first, and few runs have no quantiles
    table, spread = out.split("Compared", maxsplit=1)
    heads = next(line for line in table.splitlines() if "variant" in line)
    assert [cell.strip() for cell in heads.split("┃")[2:-1]] == ["0.1", "0.2"]
    (flung,) = [line for line in table.splitlines() if line.startswith("│ flung")]
    assert flung.count("(1 of 1 failed)") == 2
    assert spread.count("too few runs") == 2
    folder = tmp_path / "runs" / "study-short"
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "<svg" in page
    assert "src=" not in page
    assert {path.stem for path in (folder / "figures").iterdir()} == {"curves"}
    table = pq.read_table(folder / "rows.parquet")
    with (folder / "rows.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert table.num_rows == len(rows) == 4
    units = {each.name: each.metadata[b"unit"].decode() for each in table.schema}
    assert units["rms_error"] == units["rms_distance"] == "m"
    assert (units["tracking_error_percent"], units["outcome"]) == ("%", "")
    assert json.loads(table.schema.metadata[b"ballplate"])["versions"]["python"].startswith("3.")
    assert [row["outcome"] != "finished" for row in rows] == [
        v == "flung" for v in table["variant"].to_pylist()
    ]


@pytest.mark.short("grid")
@pytest.mark.parametrize("method", ["grid", "lhs"])
def test_what_is_said_to_be_written_is_there_and_nothing_else(study, tmp_path, method) -> None:
    (tmp_path / "short.toml").write_text(STUDY.replace('"grid"', f'"{method}"\nsamples = 2'))
    told = study("short.toml", "--processes", "1")[1].rpartition("written to")[2]
    folder, _, names = " ".join(told.split()).partition(": ")
    there = {path.name for path in (tmp_path / folder).iterdir()} - {"chunks"}
    assert {name.strip("/") for name in names.split(", ")} == there
    assert ("figures/" in (tmp_path / folder / "report.html").read_text()) == ("figures" in there)


SCREENED = """
title = "Screened"
scenario = "hold"
set = ["duration=0.3", "baseline=false"]
method = "montecarlo"
samples = 4
metrics = ["rms_error"]

[parameters."plant.start.x_rate"]
uniform = [0.01, 0.05]
"""


@pytest.mark.long
def test_a_screened_study_says_what_ran_on_which_plant(study, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("twin.study.compiled.knows", lambda scenario: False)  # nothing to compile
    (tmp_path / "screened.toml").write_text(SCREENED)
    told = ("screened.toml", "--screen", "2", "--processes", "1")
    code, out, _ = study(*told, "--plan")
    assert code == 0
    assert "16 runs, 16 of them left" in out
    words = " ".join(out.split())
    assert "12 of the runs are on the exact equations, and up to 8 more on the mechanism" in words
    assert json.loads(study(*told, "--plan", "--json")[1])["checked_at_most"] == 8
    code, out, _ = study(*told)
    assert code == 0
    assert "4 runs on the mechanism" in " ".join(out.split())
    assert "Bias of the exact equations" in out
    found = json.loads(study(*told, "--json")[1])["screen"]
    assert found["runs"] == {"mechanism": 4, "paired": 4, "wide": 8, "checked": 8}
    assert {each["which"] for each in found["checked"]} == {"worst", "best"}


def test_a_screen_and_its_plan_refuse_an_engine_in_one_line(study, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "screened.toml").write_text(SCREENED)
    for more in ((), ("--plan",)):
        code, _, error = study("screened.toml", "--screen", "2", "--engine", "c", *more)
        assert code == 2
        assert "--engine c: not with --screen: its runs on the mechanism need Python" in error


@pytest.mark.parametrize("method", ["grid", "lhs"])
def test_points_that_are_not_drawn_independently_are_not_screened(study, tmp_path, method) -> None:
    (tmp_path / "short.toml").write_text(STUDY.replace('"grid"', f'"{method}"\nsamples = 2'))
    code, _, error = study("short.toml", "--screen", "2")
    assert code == 2
    assert len(error.strip().splitlines()) == 1
    assert "short.toml: screen: method must be montecarlo or sobol" in error


@pytest.mark.long
def test_a_summary_for_the_documentation_has_its_pictures_beside_it(
    study, tmp_path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    study_page.write("short.toml", tmp_path / "pages")
    text = (tmp_path / "pages" / "short.md").read_text(encoding="utf-8")
    assert text.startswith("# Short study")
    assert "(short-curves.svg)" in text
    assert (tmp_path / "pages" / "short-curves.svg").is_file()


def test_a_finished_study_answers_at_once_with_the_same_words_and_as_one_json_object(study) -> None:
    first = study("short.toml", "--processes", "1")[1]
    code, again, _ = study("short.toml", "--processes", "1", "--plan")
    assert "0 of them left in 0 batches" in again
    assert study("short.toml", "--processes", "1")[1] == first
    assert code == 0
    found = json.loads(study("short.toml", "--processes", "1", "--json")[1])
    (ended,) = found["endings"]
    assert ended.startswith("flung: 2 ")
    assert ended in " ".join(first.split())
    flung = found["variants"]["flung"]
    assert (flung["failed"], flung["median"]) == (2, None)
    assert flung["chance_to_fail"][1] == pytest.approx(1.0)
