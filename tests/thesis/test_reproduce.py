import json
import runpy
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from twin.cli.analyse import reproduce
from twin.errors import ScenarioError, TwinError
from twin.thesis.reproduce.cases import (
    COLUMNS,
    SimulationCase,
    SimulationTrace,
    chosen,
    judge,
    tables,
)
from twin.thesis.reproduce.compare import (
    Agreement,
    ReproductionJob,
    carry_out,
    compare,
    plan,
    row_results,
)
from twin.thesis.reproduce.simulated import exact, sampled

KEYS = {
    "table",
    "row",
    "column",
    "thesis",
    "exact",
    "sampled",
    "mujoco",
    "deviation_percent",
    "note",
}


def call(*arguments):
    runner = CliRunner(env={"COLUMNS": "200"})
    return runner.invoke(reproduce, arguments, catch_exceptions=False, standalone_mode=False)


def by_place(found):
    return {(one.place, one.way): one for one in found}


@pytest.fixture(scope="module")
def steps():
    """Table 8.1 computed in every way."""
    found = by_place(row_results(plan(chosen(["8.1"])), 1, lambda _: None))
    return chosen(["8.1"]), found


def test_all_251_numbers_of_the_21_tables_are_there():
    assert list(tables()) == [f"8.{number}" for number in range(1, 22)]
    counts = {name: sum(len(row.cells) for row in table.rows) for name, table in tables().items()}
    assert counts["8.1"] == counts["8.2"] == 15
    assert sum(counts.values()) == 2 * 15 + 9 * 9 + 4 * 5 + 8 * 15 == 251


def test_every_remark_and_setting_belongs_to_something():
    for table in tables().values():
        for row in table.rows:
            SimulationCase(**row.setup)
            assert set(row.cells) <= set(COLUMNS)
            assert {*row.notes, *row.exceptions} <= set(row.cells)


@pytest.mark.long
def test_table_8_1_agrees_with_the_thesis_in_every_way_of_computing_it(steps):
    for cell in compare(*steps):
        assert cell.verdict is Agreement.AGREES
        for value in (cell.exact, cell.sampled, cell.mujoco):
            spread = 7 if cell.column == "t_ss" else 5
            assert value.value == pytest.approx(cell.thesis, rel=spread / 100, abs=1e-9)


@pytest.mark.long
def test_table_8_4_agrees_with_the_thesis_to_4_percent():
    for job in plan(chosen(["8.4"])):
        if job.way != "exact":
            continue
        for row, found in zip(tables()["8.4"].rows, carry_out(job), strict=True):
            for column, thesis in row.cells.items():
                assert found.values[column][0] == pytest.approx(thesis, rel=0.04)


def altered(table, column, **changes):
    """The table with its first row's number three times as large."""
    row = table.rows[0]
    cells = {**row.cells, column: 3 * row.cells[column]}
    return replace(table, rows=(replace(row, cells=cells, **changes), *table.rows[1:]))


@pytest.mark.long
def test_a_cell_out_of_bounds_differs_unless_a_reason_is_known(steps):
    (table,), found = steps
    plain = compare([altered(table, "u1_max")], found)
    excused = compare([altered(table, "u1_max", exceptions={"u1_max": "copied"})], found)
    assert [cell.column for cell in plain if cell.verdict is Agreement.DIFFERS] == ["u1_max"]
    (cell,) = (cell for cell in excused if cell.verdict is not Agreement.AGREES)
    assert cell.verdict is Agreement.EXCEPTION
    assert cell.note.startswith("copied")


@pytest.mark.long
def test_a_settling_time_outside_what_could_be_read_differs(steps):
    (table,), found = steps
    row = replace(table.rows[1], cells={**table.rows[1].cells, "t_ss": 3.2})
    cells = compare([replace(table, rows=(table.rows[0], row, table.rows[2]))], found)
    assert [c.column for c in cells if c.verdict is Agreement.DIFFERS] == ["t_ss"]


@pytest.mark.long
def test_the_exit_code_is_1_when_a_cell_differs_without_a_reason(steps, monkeypatch):
    (table,), found = steps
    monkeypatch.setattr("twin.thesis.reproduce.compare.row_results", lambda *_: found.values())
    assert call("8.1").return_value == 0
    monkeypatch.setattr("twin.thesis.reproduce.cases.chosen", lambda _: [altered(table, "u1_max")])
    assert call("8.1").return_value == 1


@pytest.mark.long
def test_json_is_a_list_of_cells_and_nothing_else(steps, monkeypatch):
    monkeypatch.setattr("twin.thesis.reproduce.compare.row_results", lambda *_: steps[1].values())
    cells = json.loads(call("8.1", "--json").stdout)
    assert len(cells) == 15
    assert all(set(cell) >= KEYS for cell in cells)
    (effort,) = (
        cell for cell in cells if (cell["row"], cell["column"]) == ("case 2", "u1_max [rad/s^2]")
    )
    assert effort["thesis"] == 1.7839
    assert effort["deviation_percent"] == 100 * (effort["exact"] / 1.7839 - 1)
    # A thesis value of 0 has no deviation in percent.
    assert all(c["deviation_percent"] is None for c in cells if c["column"] == "overshoot [%]")


def test_an_unknown_table_is_one_line_that_lists_the_known_ones():
    with pytest.raises(ScenarioError, match=r"no table '8\.22'; there are 8\.1 to 8\.21 and"):
        call("8.4", "8.22")


@pytest.mark.long
def test_the_page_has_its_tables_notes_and_figures(steps, tmp_path):
    page = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "chapter8.py"))
    path = tmp_path / "docs" / "reproduction.md"
    page["write_doc"](path, steps[0], compare(*steps), steps[1])
    text = path.read_text(encoding="utf-8")
    assert text.count("| phi_max [deg] |") == 3
    assert (path.parent / "figures" / "table-8-1.png").read_bytes().startswith(b"\x89PNG")
    assert "](figures/table-8-1.png)" in text


def test_a_row_gives_the_same_alone_and_among_others():
    case = replace(SimulationCase(**tables()["8.12"].rows[1].setup), seeds=2, duration=0.3)
    other = replace(case, reference={"kind": "hold", "x": -0.1})
    for way in (exact, sampled, partial(sampled, mechanism=True)):
        (alone,), (_, among) = way([case]), way([other, case])
        assert np.abs(among.state - alone.state).max() < 1e-12
        assert np.abs(among.estimate - alone.estimate).max() < 1e-12


def test_a_failing_job_ends_in_one_line_that_names_it():
    broken = ReproductionJob("exact", (("8.1", 99),), 1.0)
    with pytest.raises(TwinError, match=r"^table 8\.1, exact: IndexError: [^\n]*$"):
        list(row_results([broken], 1, lambda _: None))


def trace(x, **parts):
    """A trace of one run that moves along x as given, by default from 0 to 1 s."""
    count = len(x)
    state = np.zeros((count, 1, 8))
    state[:, 0, 0] = x
    filled = {
        "time": np.linspace(0, 1, count),
        "state": state,
        "u": np.zeros((count, 1, 2)),
        "reference": np.ones((count, 2)),
        "estimate": state,
        **parts,
    }
    return SimulationTrace(**filled)


CASE = SimulationCase(duration=1.0, controller={}, reference={})


def test_the_overshoot_is_relative_to_the_value_at_the_end():
    found = judge(trace(np.array([0.0, 0.5, 1.2, 0.8])), CASE, ("overshoot",))
    assert found["overshoot"] == pytest.approx([50.0])


def test_settling_times_are_read_with_three_bands_and_end_with_the_run():
    x = 1 - np.exp(-4 * np.linspace(0, 1, 1001))
    case = replace(CASE, bands=(5.0, 1.0, 10.0))
    found = judge(trace(x), case, ("t_ss",))
    expected = [-np.log(0.05) / 4, 1.0, -np.log(0.1) / 4]  # exp(-4) is more than 1 %
    assert found["t_ss"] == pytest.approx(expected, abs=1.1e-3)


def test_the_average_tracking_error_is_a_root_mean_square():
    x = 1 - np.sin(2 * np.pi * np.linspace(0, 1, 1001)[:-1])
    assert judge(trace(x), CASE, ("rms_error",))["rms_error"] == pytest.approx([np.sqrt(0.5)])


def test_a_run_that_ended_early_has_no_values():
    assert judge(trace(np.zeros(4), ended="fell"), CASE, ("rms_error",)) == {"rms_error": []}
