"""Tests of `twin.cli`."""

import csv
import json

import pytest

from twin.run.finished import run
from twin.scenario.load import load
from twin.scenario.variations import swept

pytestmark = pytest.mark.usefixtures("quick_pictures")

SHORT = ("plant.kind=lagrange", "duration=0.3", "metrics.start=0")
QUICK = [word for text in SHORT for word in ("--set", text)]


def test_values_are_evenly_spaced_whole_where_all_are_or_listed():
    assert swept("a.b=0:0.5:6") == ("a.b", [0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert repr(swept("seed=1:5:3")) == "('seed', [1, 3, 5])"  # a seed of 1.0 is refused
    assert swept("seed=1:4:3") == ("seed", [1.0, 2.5, 4.0])
    assert swept('controller.kind=["afl", "lqr"]') == ("controller.kind", ["afl", "lqr"])


def test_a_sweep_gives_of_each_value_what_run_gives(ballplate, tmp_path):
    asked = ("step", "controller.rho=100:300:2", "--vary", "seed=[1,2]", "-j", "1", "--json")
    code, out, err = ballplate("sweep", *asked, *QUICK)
    assert code == 0, err
    found = json.loads(out)
    alone = run(load("step", [*SHORT, "seed=2", "controller.rho=300"]))
    assert found["runs"]["2"][1]["rms_error"] == alone.metrics["rms_error"]
    (folder,) = (tmp_path / "runs").iterdir()
    assert folder.name.startswith("sweep-step-controller.rho=100..300..2-seed=1,2")
    assert (folder / "sweep.png").is_file()
    rows = list(csv.DictReader((folder / "sweep.csv").read_text().splitlines()))
    assert [(row["controller.rho"], row["seed"]) for row in rows] == [
        ("100", "1"), ("100", "2"), ("300", "1"), ("300", "2"),
    ]  # fmt: skip
    assert float(rows[3]["rms_error [m]"]) == alone.metrics["rms_error"]


@pytest.mark.long
def test_a_value_at_which_the_ball_is_lost_is_told_in_the_table(ballplate):
    code, out, _ = ballplate("sweep", "hold", "plant.start.x=[0.0, 0.3]", "-j", "1", *QUICK)
    assert code == 1
    assert "aborted at 0.00" in out
