"""`twin.safety.faults`: The fault matrix, row by row, and its document."""

import csv
import importlib
import json
import pkgutil
from dataclasses import replace
from functools import cache
from itertools import chain
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

import twin.devices
import twin.hal
from docs import own_faults, pages
from docs import safety as safety_page
from twin.base.data_file import read_packaged
from twin.base.errors import ScenarioError
from twin.cli.rig import safety
from twin.devices.own import OWN_CONDITIONS
from twin.emulator.fault_lines import MATRIX_ROWS
from twin.hal.interface import Condition, Severity
from twin.safety.causes import OF_DRIVES, OF_RIG, ROW_FUNCTIONS
from twin.safety.faults import CASES, choose_cases
from twin.safety.trial import run_case

NUMBER = {case.name: index for index, case in enumerate(CASES)}
DOCUMENT = Path(__file__).parents[2] / "docs" / "safety.md"


def document(rows, own=()):
    """Both pages that ``docs/safety.py`` writes of rows, file name to text."""
    return pages.parts(DOCUMENT.name, safety_page.document(rows, own))


MATRIX = "## Measured"

measured = cache(run_case)
"""A row of the matrix; virtual time makes it the same on every run."""


own_measured = cache(own_faults.carried_out)
"""A row of the matrix of hardware of one's own."""


def conditions():
    """Every condition of any module of the devices and of what judges them, listed or not.

    Those of hardware of one's own have rows of their own, of ``docs/own_faults.py``.
    """
    found = {}
    for package in (twin.hal, twin.devices):
        for each in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            module = importlib.import_module(each.name)
            values = [value for value in vars(module).values() if isinstance(value, Condition)]
            found.update({id(value): value for value in values})
    own = {id(each) for each in OWN_CONDITIONS}
    return [each for key, each in found.items() if key not in own]


def tables(text):
    """The rows of a Markdown document, by the heading above them."""
    found, heading = {}, ""
    for line in text.splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
        elif line.startswith("| ") and not line.startswith("| ---"):
            cells = tuple(cell.strip() for cell in line.strip("|").split("|"))
            found.setdefault(heading, []).append(cells)
    return {heading: rows[1:] for heading, rows in found.items()}


@pytest.mark.long
@pytest.mark.parametrize("name", NUMBER)
def test_a_fault_is_detected_in_time_answered_safely_recorded_and_recovered_from(name):
    row = measured(NUMBER[name])
    assert row.good, row


def test_names_of_the_cases_are_all_different():
    assert len(NUMBER) == len(CASES)


def named_by(given):
    """Every cause and function that a row names, also within others."""
    name, *arguments = [given] if isinstance(given, str) else given
    inner = {"together": arguments, "in_turn": arguments, "then": arguments[1:]}.get(name, ())
    return {name}.union(*map(named_by, inner))


def test_every_cause_and_function_that_a_row_names_is_there():
    rows = read_packaged("twin.safety", "cases.toml").values()
    names = {each for row in chain(*rows) for key in ("act", "begins") if key in row
             for each in named_by(row[key])}  # fmt: skip
    assert "no_zero_rate" in names
    assert names <= {*OF_DRIVES, *OF_RIG, *ROW_FUNCTIONS}


@pytest.mark.long
def test_a_run_that_nothing_happens_to_would_fail_a_row(monkeypatch):
    case = CASES[NUMBER["The STO input of drive phi opens"]]
    idle = type(case)(name="nothing", act=lambda rig: None, expected=case.expected)
    monkeypatch.setattr("twin.safety.trial.CASES", (idle,))
    monkeypatch.setattr("twin.safety.trial.FAULT_BEGIN_S", 0.3)
    monkeypatch.setattr("twin.safety.trial.RUN_AFTER_S", 0.3)
    row = run_case(0)
    assert row.detected is None
    assert not row.good


def test_the_document_has_exactly_the_conditions_that_the_code_has():
    rows = tables(document([])[DOCUMENT.name])
    listed = [row for rows in rows.values() for row in rows if len(row) == 5]
    assert len(listed) > 50
    assert sorted(listed) == sorted(
        (
            each.name,
            str(each.severity),
            f"{1e3 * each.within:g}",
            each.reaction,
            each.recovery,
        )
        for each in (*conditions(), *OWN_CONDITIONS)
    )


@pytest.mark.long
@pytest.mark.parametrize("row", own_faults.ROWS, ids=lambda row: row.name)
def test_a_fault_of_hardware_of_ones_own_is_detected_in_time_and_ends_level(row):
    assert own_measured(row).good, own_measured(row)


@pytest.mark.long
@pytest.mark.parametrize(
    ("row", "broken", "failures"),
    [
        ("The picture is frozen", ("rest", 9.0), {"detected"}),
        ("The board says nothing any more", ("silent", 4.0), {"detected", "reason"}),
        (
            "Nothing of the host arrives any more, and the plate has an encoder",
            ("astray_deg", 19.0),
            {"detected"},
        ),
    ],
)
def test_a_row_of_hardware_of_ones_own_is_bad_without_its_net(row, broken, failures, monkeypatch):
    (chosen,) = (each for each in own_faults.ROWS if each.name == row)
    monkeypatch.setattr(own_faults, "CONFIG", replace(own_faults.CONFIG, **dict([broken])))
    assert failures <= set(own_faults.carried_out(chosen).failures)


def test_every_condition_has_a_row_in_the_matrix():
    expected = {id(case.expected) for case in CASES}
    assert [each.name for each in conditions() if id(each) not in expected] == []
    own = {row.expected.name for row in own_faults.ROWS if row.expected}
    assert [each.name for each in OWN_CONDITIONS if each.name not in own] == []


def test_every_condition_that_stops_or_levels_says_how_to_go_on():
    for condition in conditions():
        if condition.severity is not Severity.WARNING:
            assert condition.recovery not in {"", "none needed"}


def test_the_document_in_the_repository_has_the_states_and_conditions_of_the_code():
    for name, page in document([]).items():
        kept = DOCUMENT.with_name(name).read_text(encoding="utf-8")
        assert kept.partition(MATRIX)[0] == page.partition(MATRIX)[0]


@pytest.mark.long
def test_the_document_in_the_repository_is_the_one_that_the_command_writes():
    rows = [measured(index) for index in range(len(CASES))]
    for name, page in document(rows, [own_measured(row) for row in own_faults.ROWS]).items():
        assert DOCUMENT.with_name(name).read_text(encoding="utf-8") == page


@pytest.mark.parametrize("good", [False, True])
def test_the_command_exits_with_1_if_a_row_is_bad(monkeypatch, good):
    row = SimpleNamespace(good=good, as_dict=lambda: {"good": good})
    monkeypatch.setattr("twin.safety.trial.run_all", lambda *_: [row])
    monkeypatch.setattr("twin.cli.rig._table", lambda rows: "")
    done = CliRunner(catch_exceptions=False).invoke(safety, ["--json"], standalone_mode=False)
    assert json.loads(done.stdout) == [{"good": good}]
    assert done.return_value == int(not good)


def test_cases_are_chosen_by_words_of_their_names_and_conditions():
    names = [CASES[index].name for index in choose_cases(["wrong WAY", "axes exch"])]
    assert "The plate encoder of phi counts the wrong way" in names
    assert "The plate encoders are exchanged" in names  # by its condition
    assert len(names) < 20
    assert choose_cases([]) == list(range(len(CASES)))
    assert not any("sends" in CASES[index].name for index in choose_cases(["counts"]))
    for words in ("no such fault", " "):
        with pytest.raises(ScenarioError, match="no fault or condition contains these words"):
            choose_cases([words])


def test_a_fault_of_a_run_is_chosen_by_its_name_and_no_other_with_it():
    for name, row in MATRIX_ROWS.items():
        assert [CASES[index].name for index in choose_cases([name])] == [row]
    (former,) = choose_cases(["Drive fault of phi"])
    assert CASES[former].name == "Drive phi has a fault"


def test_chosen_faults_are_listed_or_injected_and_written_as_a_sheet(tmp_path, monkeypatch):
    monkeypatch.setattr("twin.safety.trial.FAULT_BEGIN_S", 0.5)
    monkeypatch.setattr("twin.safety.trial.RUN_AFTER_S", 0.6)
    chosen = ("--only", "encoder of phi counts the wrong way")
    listed = CliRunner().invoke(safety, [*chosen, "--list", "--json"])
    assert json.loads(listed.stdout) == [
        {
            "name": "The plate encoder of phi counts the wrong way",
            "condition": "plate turns against its motor",
            "fault": "",
        }
    ]
    sheet = tmp_path / "fmea.csv"
    ran = CliRunner().invoke(safety, [*chosen, "--out", str(sheet), "--json", "-j", "1"])
    assert ran.exit_code == 0, ran.output
    (row,) = json.loads(ran.stdout)
    (line,) = csv.DictReader(sheet.read_text(encoding="utf-8").splitlines())
    assert line["fault"] == row["name"]
    assert line["detection: condition"] == "plate turns against its motor"
    assert float(line["detection: time [s]"]) == pytest.approx(row["detected"], abs=1e-4)
    tilt = np.radians(float(line["effect: largest tilt [deg]"]))
    assert tilt == pytest.approx(row["tilt"], abs=1e-4)
    assert line["verdict"] == "good"
