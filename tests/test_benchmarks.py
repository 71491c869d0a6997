"""`benchmarks`: What the page of performance says of measurements on several machines and days."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import beside_commit, exact_plant, figures, measurements, memory, realtime
from benchmarks.__main__ import TEMPLATE
from benchmarks.figures import GOALS, Figure, Goal
from benchmarks.measurements import Measurement

LOOP = "closed loop of one rig, sine, times bare mj_step, least"
EXACT = "exact plant, without friction, times as fast as plain RK4"


def measurement(**found):
    return Measurement("2026-01-01", "one", "some", 0.1, found, {})


def row(table, what):
    (line,) = [line for line in table.splitlines() if line.startswith(f"| {what} |")]
    return [cell.strip() for cell in line.split("|")[2:6]]


@pytest.mark.parametrize(
    ("values", "said", "reached"),
    [
        ([2.8, 3.1], "2.80 to 3.10", "yes"),
        ([2.8, 5.9], "2.80 to 5.90", "partly"),
        ([5.9, 2.8], "2.80 to 5.90", "partly"),
        ([5.2, 5.9], "5.20 to 5.90", "no"),
        ([3.2], "3.20", "yes"),
    ],
)
def test_a_goal_is_reached_only_where_every_measurement_keeps_it(values, said, reached):
    table = measurements.figures_table([measurement(**{LOOP: [value] * 2}) for value in values])
    assert row(table, LOOP) == [said, str(len(values)), "at most 3.2", reached]


def test_every_comparison_with_an_earlier_commit_has_a_row(monkeypatch, tmp_path):
    monkeypatch.setattr(beside_commit, "measure", lambda place, row: 2.0 + (place == tmp_path))
    found = list(figures.beside(tmp_path, 1))
    table = measurements.figures_table([measurements.now(found, 0.1)])
    for each in beside_commit.ROWS:
        goal = each.goal
        judged = (
            ["-", ""] if goal is None else [f"at most {goal:g}", "no" if goal < 0.67 else "yes"]
        )
        assert row(table, each.figure) == ["0.67", "1", *judged]


def test_one_measurement_may_be_an_interval_and_the_least_counts_where_much_is_asked():
    table = measurements.figures_table([measurement(**{EXACT: [2.9, 3.5]}), measurement()])
    assert row(table, EXACT) == ["2.90 to 3.50", "1", "at least 3", "partly"]
    assert Goal(3, most=False).reached(3.0, 9.0) == "yes"
    assert LOOP not in table


def test_a_measurement_is_added_behind_those_that_are_kept(tmp_path):
    file = tmp_path / "performance.toml"
    file.write_bytes(measurements.FILE.read_bytes())
    before = measurements.kept(file)
    new = measurements.now([Figure(LOOP, 4.56789, "1 and 2"), Figure(EXACT, 3.0)], 0.12, 'a "b"')
    measurements.add(new, file)
    *others, last = measurements.kept(file)
    assert repr(others) == repr(before)
    assert last == new
    assert (last.found, last.notes) == ({LOOP: [4.568] * 2, EXACT: [3.0] * 2}, {LOOP: "1 and 2"})
    assert (last.machine, last.load) == ('a "b"', 0.1)


def test_the_exact_plant_is_measured_against_a_baseline_that_runs():
    rates = exact_plant.commands(2)
    for friction in (None, figures.ROLLING):
        assert exact_plant.plain(friction, rates) > 0 < exact_plant.exact(friction, rates)


@pytest.mark.long
def test_every_command_after_the_first_second_is_timed():
    exact = ["plant.kind=lagrange"]
    thesis, cure = (realtime.command_times(name, exact, 0.1) for name in ("circle", "cure"))
    assert len(thesis) == len(cure) == 50
    assert 1 < np.median(thesis) < np.median(cure) < 2000


def test_the_page_is_made_of_what_is_kept():
    page = (Path(measurements.FILE).parents[1] / "performance.md").read_text(encoding="utf-8")
    known = measurements.kept()
    assert measurements.figures_table(known) in page
    assert measurements.measurements_table(known) in page
    assert all(what in GOALS for each in known for what in each.found)
    template = TEMPLATE.read_text(encoding="utf-8")
    for text in template.split("{{")[1].partition("}}")[2], template.split("}}")[3]:
        assert text.strip() in page


def test_the_largest_memory_of_a_process_is_its_own():
    held = np.ones(25_000_000)  # 200 MB here, which Linux would count for what this process starts
    assert memory.peak_mib("import sys", 1) < 50 < held.nbytes / 2**20
