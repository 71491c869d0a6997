"""Tests of `twin.run.files`."""

import os
from pathlib import Path

import pytest

from twin.base.errors import LogError, RecordError, ScenarioError
from twin.base.shipped import find
from twin.run.files import (
    MAX_NAME_LENGTH,
    forget,
    free,
    last,
    log_file,
    read_links,
    record_of,
    run_folder,
    run_folders,
    run_name,
)


def make_run_folder(folder, when):
    folder.mkdir(parents=True)
    file = folder / "run.parquet"
    file.touch()
    os.utime(file, (when, when))
    return folder


@pytest.mark.parametrize(
    ("name", "overrides", "folder"),
    [
        ("circle", (), "circle"),
        ("mine/own.toml", ("duration=10",), "own-duration=10"),
        ("circle", ("plant.friction.rolling_mm=0",), "circle-friction.rolling_mm=0"),
        ("step", ("controller.kind=lqr", "plant.kind=exact"), "step-controller=lqr-plant=exact"),
        ("circle", ("controller.ball=[3, 3]",), "circle-controller.ball=3,3"),
        ("circle", ("duration=10", "duration=20"), "circle-duration=20"),
    ],
)
def test_a_folder_is_named_by_what_differs(name, overrides, folder):
    assert run_folder(name, overrides) == Path("runs") / folder


def test_names_that_had_to_be_changed_stay_apart():
    # cut between two settings
    parts = [f"controller.gain{n}=1.25" for n in range(9)]
    whole = run_folder("circle", parts).name
    assert len(whole) <= MAX_NAME_LENGTH
    assert "-".join(("circle", *parts)).startswith(whole[:-7])  # without the hash of it
    assert whole[:-7].endswith("=1.25")
    long = [run_folder("circle", [f"title={'x' * 200}{end}"]) for end in "ab"]
    strange = [run_folder("circle", [f"parameters={end}/fit.toml"]) for end in "ab"]
    assert len(set(long)) == len(set(strange)) == 2
    assert all(len(path.name) <= 100 and "/" not in path.name for path in (*long, *strange))


def test_the_last_run_is_the_newest_also_within_a_comparison(tmp_path):
    with pytest.raises(RecordError, match="no run in"):
        last(tmp_path / "none")
    make_run_folder(tmp_path / "old", 100)
    make_run_folder(tmp_path / "compare" / "a", 300)
    make_run_folder(tmp_path / "newer", 200)
    (tmp_path / "study").mkdir()
    assert last(tmp_path) == tmp_path / "compare"


def test_a_run_on_a_rig_replaces_nothing(tmp_path):
    folder = tmp_path / "circle"
    assert free(folder) == folder
    make_run_folder(folder, 100)
    assert free(folder) == tmp_path / "circle~2"


def test_a_run_that_was_killed_is_found_and_not_written_over(tmp_path):
    folder = make_run_folder(tmp_path / "hold", 100)
    (folder / "run.parquet").rename(folder / "run.arrows")
    assert last(tmp_path) == folder
    assert record_of(folder) == folder / "run.arrows"
    assert run_name(folder) == "hold"
    assert free(folder) == tmp_path / "hold~2"
    (folder / "run.parquet").touch()
    assert record_of(folder) == folder / "run.parquet"


def test_a_run_keeps_its_whole_name_however_it_is_reached(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = make_run_folder(Path("runs") / "circle-friction.rolling_mm=0", 100)
    for path in (run, run / "run.parquet", Path("last")):
        assert run_name(path) == "circle-friction.rolling_mm=0"
        assert log_file(path) == run / "run.parquet"
    assert run_name(Path("rig.july.csv")) == "rig.july"


def test_what_is_no_log_is_told_by_what_it_is(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one, _ = make_run_folder(Path("both") / "a", 100), make_run_folder(Path("both") / "b", 100)
    with pytest.raises(
        RecordError, match=f"both: contains 2 runs; give one of them, such as {one}"
    ):
        log_file(Path("both"))
    with pytest.raises(RecordError, match="circle is a scenario, not a run; first: ballplate run"):
        log_file(Path("circle"))
    with pytest.raises(LogError, match=r"log no\.csv: not found"):
        log_file(Path("no.csv"))


def test_the_only_run_of_a_comparison_is_meant_by_its_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = make_run_folder(Path("runs") / "compare-circle" / "rolling_mm=0.1", 100)
    for path in (Path("runs") / "compare-circle", Path("last")):
        assert log_file(path) == run / "run.parquet"


def test_a_run_and_a_folder_are_no_scenarios(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = make_run_folder(Path("runs") / "circle", 100)
    for name in ("last", str(run)):
        with pytest.raises(
            ScenarioError, match=f"'{name}' is a run, not a scenario; .* report {name}"
        ):
            find(name)
    with pytest.raises(ScenarioError, match="that is a folder"):
        find("runs")


@pytest.mark.parametrize("name", ["..", "", ".", "/", "a/..", "\\u0000"])
def test_a_list_of_folders_that_are_none_removes_nothing(name, tmp_path):
    run = make_run_folder(tmp_path / "run", 1)
    inner = run / "made"
    inner.mkdir()
    (inner / "run.parquet").touch()
    (inner / "compare.json").write_text(f'{{"folders": ["{name}"], "names": ["a"]}}')
    forget(inner)
    assert (run / "run.parquet").is_file()
    assert (inner / "run.parquet").is_file()


@pytest.mark.parametrize(
    "link",
    [
        '{"position": 1e300, "run": "../a"}',
        '{"position": -1, "run": "../a"}',
        '{"position": 99999999999999999999, "run": "../a"}',
        '{"position": 0, "run": "\\u0000"}',
        '{"position": [], "run": "../a"}',
        '{"position": 0}',
        "3",
    ],
)
def test_a_link_that_is_damaged_links_to_nothing(link, tmp_path):
    make_run_folder(tmp_path / "a", 1)
    make_run_folder(tmp_path / "made/b", 2)
    (tmp_path / "made/compare.json").write_text(f'{{"folders": [], "linked": [{link}]}}')
    assert read_links(tmp_path / "made") == []
    assert run_folders(tmp_path / "made") == [tmp_path / "made/b"]
