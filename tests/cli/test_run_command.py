"""`twin.cli`: The run command: what it prints and what it leaves."""

import json
import re
from pathlib import Path

import pytest

import twin.run.picture

pytestmark = pytest.mark.usefixtures("quick_pictures")

QUICK = ("--plant", "lagrange", "--set", "duration=0.2", "--set", "metrics.start=0")
KEYS = {
    "outcome", "outcome_time", "tracking_error_percent", "rms_error", "mean_error",
    "max_steady_error", "overshoot_percent", "settling_time", "steady_error", "phi_max_deg",
    "theta_max_deg", "u1_max", "u2_max", "real_time_factor",
}  # fmt: skip


@pytest.mark.long
def test_run_prints_a_table_and_writes_a_folder(ballplate, tmp_path):
    code, out, _ = ballplate("run", "circle", *QUICK)
    assert code == 0
    assert "tracking error" in out
    (folder,) = (tmp_path / "runs").iterdir()
    assert folder.name == "circle-duration=0.2-metrics.start=0-plant=lagrange"
    assert f"written to runs/{folder.name}/: picture.png" in out
    written = {path.name for path in folder.iterdir()}
    assert written == {"run.parquet", "metrics.json", "picture.png"}


@pytest.mark.long
def test_run_shows_another_scenario_beside(ballplate):
    code, out, _ = ballplate("run", "circle", *QUICK, "--beside", "cure")
    assert code == 0
    assert re.search(r"exact equations\s*┃\s*cure\s*┃", out)


NO_UNIT = {"scenario", "outcome", "reason", "units"}


def test_run_json_has_the_unit_of_every_number_a_verdict_and_the_baseline(ballplate):
    short = ("--set", "duration=1.0", "--set", "metrics.start=0")
    code, out, _ = ballplate("run", "circle", *short, "--json")
    assert code == 0
    found = json.loads(out)
    assert set(found) >= KEYS
    verdict, model = found.pop("verdict"), found.pop("baseline")
    assert found.keys() - NO_UNIT == found["units"].keys()
    assert found["units"]["rms_distance"] == "m"
    assert model.keys() == found.keys()
    assert model["outcome"] == "finished"
    assert model["u_rms"] != found["u_rms"]
    own, clean = (each["tracking_error_percent"] for each in (found, model))
    assert f"e_tt {own:.3g} % ({clean:.3g} % on the clean model)" in verdict
    (folder,) = Path("runs").iterdir()
    assert json.loads((folder / "metrics.json").read_text()) == found
    code, out, _ = ballplate("run", "circle", *QUICK, "--json")
    assert json.loads(out)["baseline"] is None
    code, out, _ = ballplate("compare", str(folder), "--json")
    (opened,) = json.loads(out).values()
    kept = ("judged_from", "real_time_factor")  # of a run just made
    assert opened == {key: value for key, value in found.items() if key not in kept}


@pytest.mark.long
def test_a_run_that_fell_exits_with_one_and_keeps_its_record(ballplate, tmp_path):
    code, out, _ = ballplate(
        "run", "hold", "--plant", "lagrange", "--set", "duration=2",
        "--set", "plant.start.x=0.3", "--set", "plant.start.x_rate=1.0", "--out", "fell",
    )  # fmt: skip
    assert code == 1
    assert "fell" in out
    assert (tmp_path / "fell" / "run.parquet").is_file()


@pytest.mark.long
@pytest.mark.parametrize(
    ("changes", "goal", "more"),
    [
        ((), "150", ""),
        (
            ("controller.rho=90.0", "reference.x=0.1"),
            "100",
            ", controller.rho=90.0, reference.x=0.1",
        ),
    ],
)
def test_what_was_changed_is_in_the_title_of_everything_a_run_leaves(
    ballplate, tmp_path, monkeypatch, changes, goal, more
):
    drawn = []
    monkeypatch.setattr(
        twin.run.picture.Figure, "suptitle", lambda _, text, **__: drawn.append(text)
    )
    title = f"Step to ({goal}, 150) mm (duration=0.2, metrics.start=0{more}, plant.kind=lagrange)"
    asked = [word for change in changes for word in ("--set", change)]
    _, out, _ = ballplate("run", "step", *QUICK, *asked, "--out", "made")
    assert out.splitlines()[0] == title
    folder = tmp_path / "made"
    assert json.loads((folder / "metrics.json").read_text())["scenario"] == title
    assert [" ".join(text.split()) for text in drawn] == [title]
    ballplate("report", str(folder))
    assert f"<h1>{title}</h1>" in (folder / "report.html").read_text()


@pytest.mark.long
def test_the_tracking_error_comes_first_in_a_table(ballplate):
    def rows(*more):
        _, out, _ = ballplate("run", "circle", *QUICK, *more)
        return [line.split("│")[1].strip() for line in out.splitlines() if line.startswith("│")]

    first = ["tracking error e_tt", "RMS error, x, whole run"]
    assert rows() == first
    every = rows("--all")
    assert every[:3] == [*first, "outcome"]
    assert len(every) > 10
    assert len(set(every)) == len(every)


def test_faults_on_demand_need_the_virtual_rig(ballplate):
    code, _, err = ballplate("run", "hold", "--fault", "1 sto")
    assert (code, err) == (
        2,
        "ballplate: --fault: only the virtual rig can inject faults; add --rig emulated\n",
    )
