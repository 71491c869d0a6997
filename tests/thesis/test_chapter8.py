"""`twin.thesis.chapter8`.

Chapter 8: what was simulated, how a run is judged, and how cells are compared."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

from controllers.ballplate import BallPlate
from docs import chapter8 as page
from twin.cli.reproduce import reproduce
from twin.run.controller_building import build_controller
from twin.run.metrics import Motion
from twin.thesis import chapter8_runs, chapter8_tables
from twin.thesis.chapter8 import Agreement, compare, lines, sentence
from twin.thesis.chapter8_runs import COMPUTED_WAYS, ReproductionJob, RowResult, carry_out, judge
from twin.thesis.chapter8_tables import Disagreement, Reason, tables
from twin.thesis.columns import THESIS_COLUMNS, read_stored


def call(*arguments):
    runner = CliRunner(env={"COLUMNS": "200"})
    return runner.invoke(reproduce, arguments, catch_exceptions=False, standalone_mode=False)


@pytest.fixture
def steps():
    """Table 8.1, and runs of it that came to what is kept of continuous control."""
    table = tables()["8.1"]
    widths = {"state": 8, "applied": 2, "reference": 2, "estimate": 8}
    shown = {"time": np.arange(3.0)} | {name: np.zeros((3, n)) for name, n in widths.items()}
    found = {
        ((table.id, index), way): RowResult(
            (table.id, index), way, dict(read_stored("chapter_8")["8.1"][row.name]), "", shown
        )
        for index, row in enumerate(table.rows)
        for way in COMPUTED_WAYS[1:]
    }
    return [table], found


def altered(table, column, **changes):
    """The table with its first row's number three times as large."""
    row = table.rows[0]
    cells = {**row.cells, column: 3 * row.cells[column]}
    return replace(table, rows=(replace(row, cells=cells, **changes), *table.rows[1:]))


def test_all_251_numbers_of_the_21_tables_are_there():
    assert list(tables()) == [f"8.{number}" for number in range(1, 22)]
    counts = {name: sum(len(row.cells) for row in table.rows) for name, table in tables().items()}
    assert counts["8.1"] == counts["8.2"] == 15
    assert sum(counts.values()) == 2 * 15 + 9 * 9 + 4 * 5 + 8 * 15 == 251


def test_every_remark_setting_and_kept_value_belongs_to_something():
    for table in tables().values():
        assert set(read_stored("chapter_8")[table.id]) == {row.name for row in table.rows}
        for row in table.rows:
            row.scenario("sampled")
            assert set(row.cells) <= set(THESIS_COLUMNS)
            assert {*row.notes, *row.exceptions} <= set(row.cells)
            assert set(read_stored("chapter_8")[table.id][row.name]) - {"fitted"} == set(row.cells)


def test_what_is_kept_agrees_with_the_thesis(steps):
    cells = compare(*steps)
    assert [cell.verdict for cell in cells] == [Agreement.AGREES] * 15
    assert all(cell.sampled == cell.exact for cell in cells)


def test_a_cell_out_of_bounds_differs_unless_it_is_noted_and_keeps_its_reason(steps):
    (table,), found = steps
    plain = compare([altered(table, "u1_max")], found)
    known = {"u1_max": Disagreement(Reason.COPIED, "from another table")}
    excused = compare([altered(table, "u1_max", exceptions=known)], found)
    assert [cell.column for cell in plain if cell.verdict is Agreement.DIFFERS] == ["u1_max"]
    (cell,) = (cell for cell in excused if cell.verdict is not Agreement.AGREES)
    assert cell.verdict is Agreement.EXCEPTION
    assert cell.note.startswith("from another table")
    assert cell.because is Reason.COPIED


@pytest.mark.parametrize(
    ("because", "words", "mark"),
    [
        (Reason.UNEXPLAINED, "14 agree, 1 do not (1 unexplained)", "!!"),
        (Reason.FITTED, "1 do not (1 with a reason that was fitted to them afterwards)", "(!)"),
        (Reason.COPIED, "1 do not (1 that repeat the numbers of another table)", "(!)"),
        (None, "14 agree, 1 do not (1 new, not noted so far)", "!!"),
    ],
)
def test_the_summary_says_how_many_disagree_and_why_and_calls_no_cell_explained_that_is_not(
    steps, because, words, mark
):
    (table,), found = steps
    known = {"exceptions": {"u1_max": Disagreement(because, "why")} if because else {}}
    cells = compare([altered(table, "u1_max", **known)], found)
    assert words in sentence(cells)
    assert "known reason" not in sentence(cells)
    marks = [row[-1].split(" ")[0] for row in lines(cells)[0]]
    assert [each for each in marks if each in {"!!", "(!)"}] == [mark]


def test_notes_that_differ_in_a_fitted_value_only_are_one_note_with_all_values(steps):
    first, second, third, fourth, *_ = compare(*steps)
    texts = [
        "Why. Exact with 48 ms: 3.59 (3.3 to 3.8).",
        "Other.",
        "Exact with 48 ms: 1.",
        "Why. Exact with 48 ms: 6.3 (5.8 to 6.6).",
    ]
    cells = [
        replace(cell, note=note)
        for cell, note in zip((first, second, third, fourth), texts, strict=True)
    ]
    rows, numbered = lines(cells)
    assert [row[-1].split("[")[-1] for row in rows] == ["1]", "2]", "3]", "1]"]
    assert numbered == [
        "[1] Why. Exact with 48 ms: 3.59 (3.3 to 3.8), 6.3 (5.8 to 6.6).",
        "[2] Other.",
        "[3] Exact with 48 ms: 1.",
    ]


def test_every_cell_that_is_noted_as_unexplained_or_fitted_says_so_in_its_own_words():
    by = {kind: [] for kind in Reason}
    for table in tables().values():
        for row in table.rows:
            for each in row.exceptions.values():
                by[each.because].append(each.note)
    assert sum(map(len, by.values())) == 26
    none = ("Not reproduced", "no gain tried", "No reading", "no single reading", "A little above")
    assert all(any(word in note for word in none) for note in by[Reason.UNEXPLAINED])
    assert all("fitted, not derived" in note for note in by[Reason.FITTED])
    others = [note for kind in Reason for note in by[kind] if kind is not Reason.UNEXPLAINED]
    assert not any(word in note for note in others for word in none)
    assert {kind: len(notes) for kind, notes in by.items()} == {
        Reason.UNEXPLAINED: 9,
        Reason.FITTED: 9,
        Reason.NOT_GIVEN: 4,
        Reason.COPIED: 3,
        Reason.ARTEFACT: 1,
    }


@pytest.mark.parametrize("way", COMPUTED_WAYS[1:])
def test_the_sampled_run_must_agree_too_and_the_mechanism_need_not(way, steps):
    found = steps[1]
    one = found[("8.1", 0), way]
    found[one.place, way] = one._replace(values={**one.values, "phi_max": [1.0]})
    off = [cell.column for cell in compare(*steps) if cell.verdict is Agreement.DIFFERS]
    assert off == (["phi_max"] if way == "sampled" else [])


def test_a_settling_time_outside_what_could_be_read_differs(steps):
    (table,), found = steps
    row = replace(table.rows[1], cells={**table.rows[1].cells, "t_ss": 3.2})
    cells = compare([replace(table, rows=(table.rows[0], row, table.rows[2]))], found)
    assert [c.column for c in cells if c.verdict is Agreement.DIFFERS] == ["t_ss"]


def test_the_exit_code_is_1_when_a_cell_differs_without_a_reason(steps, monkeypatch):
    (table,), found = steps
    monkeypatch.setattr(chapter8_runs, "row_results", lambda *_: found.values())
    assert call("8.1").return_value == 0
    monkeypatch.setattr(chapter8_tables, "tables", lambda: {"8.1": altered(table, "u1_max")})
    assert call("8.1").return_value == 1


def test_json_is_a_list_of_cells_and_nothing_else(steps, monkeypatch):
    monkeypatch.setattr(chapter8_runs, "row_results", lambda *_: steps[1].values())
    cells = json.loads(call("8.1", "--json").stdout)
    assert len(cells) == 15
    keys = {
        "table",
        "row",
        "column",
        "thesis",
        *COMPUTED_WAYS,
        "deviation_percent",
        "note",
        "verdict",
    }
    keys |= {"because"}
    assert all(set(cell) - {f"{way}_range" for way in COMPUTED_WAYS} == keys for cell in cells)
    (effort,) = (
        cell for cell in cells if (cell["row"], cell["column"]) == ("case 2", "u1_max [rad/s^2]")
    )
    assert effort["thesis"] == 1.7839
    assert effort["deviation_percent"] == 100 * (effort["exact"] / 1.7839 - 1)
    # A thesis value of 0 has no deviation in percent.
    assert all(c["deviation_percent"] is None for c in cells if c["column"] == "overshoot [%]")


@pytest.mark.long
def test_the_page_has_its_tables_notes_and_figures(steps, tmp_path):
    path = tmp_path / "docs" / "reproduction.md"
    page.write_doc(path, steps[0], compare(*steps), steps[1])
    assert "](reproduction-8-1.md)" in path.read_text(encoding="utf-8")
    text = path.with_name("reproduction-8-1.md").read_text(encoding="utf-8")
    assert text.count("| phi_max [deg] |") == 3
    assert (path.parent / "figures" / "table-8-1.png").read_bytes().startswith(b"\x89PNG")
    assert "](figures/table-8-1.png)" in text


def short(monkeypatch, name, seeds=1, **setup):
    """Let a table's rows last a moment only."""
    table = tables()[name]
    about = {"duration": 0.3, "metrics": {"start": 0.1}, **setup}
    rows = [replace(row, seeds=seeds, setup={**row.setup, **about}) for row in table.rows]
    new = {name: replace(table, rows=tuple(rows))}
    monkeypatch.setattr(chapter8_runs, "tables", lambda: new)


def test_a_run_that_ended_early_has_no_values_and_the_exact_plate_has_no_edge(monkeypatch):
    short(monkeypatch, "8.4", plant={"start": {"y": 0.19, "y_rate": 0.3}}, duration=0.6)
    ends = {}
    for way in COMPUTED_WAYS[1:]:
        ends[way], *_ = carry_out(ReproductionJob(way, (("8.4", 0),), 1.0))
    assert ends["mujoco"].ended == "1 of 1 run ended early, the first fell at 0.0 s"
    assert not any(ends["mujoco"].values.values())
    assert ends["sampled"].ended == ""
    assert all(ends["sampled"].values.values())


def evaluate_column(column, x, bands=(5.0,)):
    """What a column comes to for a run along x, by default from 0 to 1 s."""
    zeros = np.zeros((len(x), 2))
    motion = Motion(
        time=np.linspace(0, 1, len(x)),
        ball=np.stack((x, 0 * x), axis=1),
        plate=zeros,
        u=zeros,
        reference=zeros + 1,
    )
    row = replace(tables()["8.1"].rows[0], cells={column: 1.0}, bands=bands)
    off = np.tile(np.arange(8.0), (len(x), 1))
    return judge(row, motion, off, 0.0)[column]


def test_the_overshoot_is_relative_to_the_value_at_the_end():
    assert evaluate_column("overshoot", np.array([0.0, 0.5, 1.2, 0.8])) == pytest.approx([50.0])


def test_settling_times_are_read_with_three_bands_and_end_with_the_run():
    x = 1 - np.exp(-4 * np.linspace(0, 1, 1001))
    expected = [-np.log(0.05) / 4, 1.0, -np.log(0.1) / 4]  # exp(-4) is more than 1 %
    assert evaluate_column("t_ss", x, (5.0, 1.0, 10.0)) == pytest.approx(expected, abs=1.1e-3)


def test_the_average_errors_are_root_mean_squares():
    x = 1 - np.sin(2 * np.pi * np.linspace(0, 1, 1001)[:-1])
    assert evaluate_column("rms_error", x) == pytest.approx([np.sqrt(0.5)])
    assert evaluate_column("x4_error", x) == pytest.approx([3.0])


@pytest.mark.parametrize(
    ("name", "index"),
    [
        ("8.1", 1),
        ("8.2", 0),
        *(
            pytest.param(*row, marks=pytest.mark.long)
            for row in (("8.3", 2), ("8.5", 1), ("8.7", 0), ("8.9", 2), ("8.10", 1))
        ),
    ],
)
def test_an_integrator_of_its_own_finds_what_is_kept_of_continuous_control(name, index):
    """By a multistep method of variable order, without any of the twin's loop, plant or seam."""
    row = tables()[name].rows[index]
    scenario = row.scenario("sampled")
    controller, model = build_controller(scenario), BallPlate()
    law, path = controller.law, controller.reference

    def rate(t, z):
        x, q = z[:8], z[8:]
        u = law.control(t, x, path, q)
        return np.concatenate((model.derivative(x, u), law.memory_rate(t, x, path, q)))

    time = np.linspace(0, scenario.duration, round(scenario.duration / 0.002) + 1)
    z = solve_ivp(
        rate, time[[0, -1]], np.zeros(8 + law.memory), "LSODA", time, rtol=1e-9, atol=1e-11
    ).y.T
    u = np.array(
        [law.control(t, row[:8], path, row[8:]) for t, row in zip(time.tolist(), z, strict=True)]
    )
    motion = Motion(time=time, ball=z[:, 0:8:4], plate=z[:, 2:8:4], u=u, reference=path(time)[0])
    found = judge(row, motion, np.zeros((len(time), 8)), scenario.metrics.start)
    for column, values in found.items():
        assert values[0] == pytest.approx(
            read_stored("chapter_8")[name][row.name][column][0], rel=1e-6
        )


MODEL = BallPlate()
STATES = arrays(float, (3, 8), elements=st.floats(-1, 1))
INPUTS = arrays(float, (3, 2), elements=st.floats(-7, 7))


@given(x=STATES, u=INPUTS)
def test_main_and_neglected_terms_are_those_of_6_42_and_all_are_the_exact_acceleration(x, u):
    x1, x2, x3, x4, x5, x6, x7, x8 = x.T
    m, s, c, (u1, u2) = MODEL, np.sin(x3), np.cos(x3), u.T
    main = m.gravity * s, -m.gravity * np.sin(x7)
    neglected = (
        -m.d / 2 * x8**2 * np.sin(2 * x3) + x1 * x8**2 * s**2 + 2 * x6 * x8 * s + x1 * x4**2,
        -m.c3 * x4 * x8 * s - 2 * x1 * x4 * x8 * c - 2 * x2 * x8 * s + x5 * x8**2,
    )
    unlisted = (
        m.gravity * s * (np.cos(x7) - 1) - m.c4 * u1 + x5 * s * u2,
        (-x1 * s + m.c4 * c) * u2,
    )
    found = page.terms(m, x, u)
    for part, expected in zip(found, (main, neglected, unlisted), strict=True):
        assert np.allclose(part, np.transpose(expected), atol=1e-12)
    assert np.allclose(sum(found), m.derivative(x, u)[:, [1, 5]] / m.c1, atol=1e-12)
