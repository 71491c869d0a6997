"""`twin.cli.output`.

The compare command: variants, scenarios, finished runs and logs side by side."""

import json
from pathlib import Path

import pytest

from twin.cli import output

pytestmark = pytest.mark.usefixtures("no_pictures")

QUICK = ("--plant", "lagrange", "--set", "duration=0.2", "--set", "metrics.start=0")


def test_compare_sets_variants_side_by_side(ballplate, tmp_path):
    code, out, _ = ballplate(
        "compare", "step", *QUICK, "--vary", "controller.rho=[100.0, 300.0]", "--json"
    )
    assert code == 0
    assert list(json.loads(out)) == ["controller.rho=100.0", "controller.rho=300.0"]
    (folder,) = (tmp_path / "runs").iterdir()
    assert folder.name.startswith("compare-step-controller.rho=100.0,300.0-duration=0.2")
    assert (folder / "compare.png").is_file()


@pytest.mark.long
def test_columns_of_variants_are_told_apart_by_value(ballplate, monkeypatch, tmp_path):
    monkeypatch.setattr(output.console, "width", 80)
    code, out, _ = ballplate(
        *("compare", "step", *QUICK, "--out", "made"),
        *("--vary", "plant.friction.rolling_mm=[0, 0.1, 0.18, 0.3]"),
    )
    assert code == 0
    title = " ".join(out.split())  # broken to fit
    assert title.startswith(
        "Step to (150, 150) mm over plant.friction.rolling_mm (duration=0.2, metrics.start=0"
    )
    assert "…" not in out
    kept = {path.name for path in (tmp_path / "made").iterdir() if path.is_dir()}
    assert kept == {f"rolling_mm={value}" for value in ("0", "0.1", "0.18", "0.3")}


@pytest.mark.long
def test_runs_that_do_not_fit_as_columns_have_a_line_each(ballplate, monkeypatch):
    monkeypatch.setattr(output.console, "width", 80)
    command = ("compare", "step", *QUICK, "--vary", f"seed={[*range(100_000, 100_008)]}")
    _, out, _ = ballplate(*command)
    lines = [line for line in out.splitlines() if line.startswith("│ seed")]
    assert [line.split("│")[1].strip() for line in lines] == [f"seed=10000{i}" for i in range(8)]
    assert "[mm]" in out
    _, out, _ = ballplate(*command, "--all")
    assert max(map(len, out.splitlines()[2:-2])) <= 80
    assert all(f"seed=10000{i}" in out for i in range(8))
    assert out.count("largest") > 1


@pytest.mark.long
def test_finished_runs_comparisons_and_patterns_are_compared_and_reported(ballplate, tmp_path):
    ballplate("run", "step", *QUICK, "--out", "runs/one")
    ballplate("compare", "step", *QUICK, "--vary", "seed=[1,2]", "--out", "runs/both")
    code, out, _ = ballplate("compare", "runs/one", "runs/both", "hold", *QUICK, "--json")
    assert code == 0
    assert list(json.loads(out)) == ["one", "seed=1", "seed=2", "hold"]
    (made,) = (tmp_path / "runs").glob("compare-*")
    ballplate("compare", *map(str, (tmp_path / "runs").glob("*")), "--json", "--out", "all")
    assert {path.name for path in Path("all").iterdir()} == {"compare.png", "compare.json"}
    code, out, err = ballplate("compare", "last", "runs/one")
    assert code == 0, err
    assert "hold, one" in out  # the newest has one run
    assert ballplate("report", "--format", "png")[0] == 0
    assert (made / "hold" / "report.png").is_file()


@pytest.mark.long
def test_a_comparison_leaves_no_run_of_the_one_before_and_nothing_of_others(ballplate):
    place = Path("made")
    ballplate("compare", "step", *QUICK, "--vary", "seed=[1,2,3]", "--out", "made")
    (place / "seed=2" / "notes.txt").touch()
    ballplate("compare", "step", *QUICK, "--vary", "seed=[3,4]", "--out", "made")
    assert sorted(path.parent.name for path in place.rglob("run.parquet")) == ["seed=3", "seed=4"]
    assert not (place / "seed=1").exists()
    assert (place / "seed=2" / "notes.txt").exists()


@pytest.mark.long
def test_a_log_lies_over_its_prediction(ballplate):
    ballplate("run", "circle", *QUICK, "--out", "made")
    ballplate("export", "made", "log.csv")
    code, out, _ = ballplate("compare", "log.csv", "circle", *QUICK[:2])
    assert code == 0
    assert "log and circle are 0 mm (RMS) apart over x and y." in out


@pytest.mark.long
def test_columns_of_several_scenarios_and_variants_name_both(ballplate):
    _, out, _ = ballplate(
        *("compare", "hold", "step", *QUICK),
        *("--vary", "controller.rho=[100.0]", "--vary", "reference.x=[0.0, 0.1]"),
    )
    assert out.startswith("hold, step over controller.rho, reference.x (")
    heading = next(line for line in out.splitlines() if line.startswith("┃"))
    assert [each.strip() for each in heading.split("┃")[2:-2]] == [
        "hold rho=100.0 x=0.0",
        "hold rho=100.0 x=0.1",
        "step rho=100.0 x=0.0",
        "step rho=100.0 x=0.1",
    ]
