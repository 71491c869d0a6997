"""`twin.cli.output`.

The compare command: variants, scenarios, finished runs and logs side by side."""

import json
from pathlib import Path

import pytest

from twin.cli import output
from twin.run.opened import open_runs

pytestmark = pytest.mark.usefixtures("no_pictures", "quick_pictures")

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
    assert (made / "report.png").is_file()


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


@pytest.mark.long
def test_named_variants_stand_in_the_place_of_their_scenario_in_the_order_typed(
    ballplate, tmp_path
):
    ballplate("run", "hold", *QUICK, "--set", "baseline=false", "--out", "runs/X")
    named = ("--with", "my PID=controller.kind=pid", "--with", "AFL=controller.kind=afl; seed=3")
    code, out, err = ballplate(
        "compare", "runs/X", "step", "hold", *named, *QUICK, "--json", "--out", "made"
    )
    assert (code, err.count("Traceback")) == (0, 0)
    assert list(json.loads(out)) == ["X", "my PID", "AFL", "hold"]
    manifest = json.loads((tmp_path / "made" / "compare.json").read_text())
    assert manifest["names"] == ["my PID", "AFL", "hold"]
    assert manifest["linked"] == [{"position": 0, "run": "../runs/X"}]
    opened = open_runs((tmp_path / "made",))
    assert [each.name for each in opened] == ["X", "my PID", "AFL", "hold"]
    assert [each.scenario.controller.kind for each in opened] == ["lqr", "pid", "afl", "lqr"]
    assert opened[2].scenario.seed == 3
    code, _, err = ballplate("report", "made", "--out", "page.html")
    assert code == 0, err
    assert all(name in Path("page.html").read_text() for name in ("X", "my PID", "AFL", "hold"))
    assert ballplate("report", "made/hold", "--out", "one.png")[0] == 0
    assert {each.name for each in tmp_path.glob("one*")} == {"one.png", "one-details.png"}


def test_a_comparison_forgets_its_own_runs_and_never_those_it_links_to(ballplate, tmp_path):
    ballplate("run", "hold", *QUICK, "--set", "baseline=false", "--out", "runs/X")
    for _ in range(2):
        code, _, _ = ballplate("compare", "runs/X", "hold", *QUICK, "--json", "--out", "made")
        assert code == 0
    assert (tmp_path / "runs/X/run.parquet").is_file()
    (tmp_path / "runs/X/run.parquet").unlink()
    code, _, err = ballplate("compare", "made", "--json", "--out", "again")
    assert code == 0
    assert "passed over" in err  # what a comparison has lost is reported


def test_a_finished_run_of_a_scenario_s_name_is_called_by_its_folder(ballplate):
    ballplate("run", "hold", *QUICK, "--set", "baseline=false", "--out", "runs/hold")
    _, out, _ = ballplate("compare", "hold", "runs/hold", *QUICK, "--json")
    assert list(json.loads(out)) == ["hold", "runs/hold"]


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        (("--with", "PID"), "--with 'PID': write NAME='KEY=VALUE; KEY=VALUE'"),
        (("--with", "=seed=1"), "--with '': a name has 1 to 60 letters"),
        (("--with", f"{'x' * 61}=seed=1"), "a name has 1 to 60 letters"),
        (("--with", "A=seed=1", "--with", "A=seed=2"), "--with 'A': two variants have this name"),
        (
            ("step", "--with", "step=seed=1"),
            "--with 'step': a scenario of this comparison has this name; give another one",
        ),
        (("--with", "A=sead=1"), "sead: unknown key; did you mean 'seed'?"),
        (
            ("--with", "A=seed=1", "--vary", "seed=[1,2]"),
            "--with and --vary: give only one of them",
        ),
    ],
)
def test_a_variant_that_cannot_be_named_is_one_line(ballplate, typed, words):
    code, _, err = ballplate("compare", "hold", *QUICK, *typed)
    assert (code, len(err.splitlines())) == (2, 1)
    assert words in err


def test_each_variant_has_a_folder_of_its_own_however_alike_their_names(ballplate, tmp_path):
    names = ('P "1"', "P '1'", "P 1", "p 1", "compare.json", "compare.png", "..", "-", "/")
    typed = [each for name in names for each in ("--with", f"{name}=controller.kind=pid")]
    code, _, _ = ballplate("compare", "hold", *QUICK, *typed, "--out", "out", "--json")
    assert code == 0
    runs = list(tmp_path.glob("out/*/run.parquet"))
    assert len({each.parent.name.casefold() for each in runs}) == len(names)
    assert not any(each.parent.name.startswith("-") for each in runs)  # no option of a command
    assert [each.name for each in open_runs([Path("out")])] == list(names)
    assert (tmp_path / "out/compare.json").is_file()


def test_variants_of_nothing_are_one_line(ballplate):
    ballplate("run", "hold", *QUICK, "--set", "baseline=false", "--out", "runs/X")
    code, _, err = ballplate("compare", "runs/X", "--with", "A=seed=1")
    assert (code, err) == (
        2,
        "ballplate: --with: nothing to run; name a scenario, such as circle\n",
    )
