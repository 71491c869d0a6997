"""The fault matrix: a few rows of every kind here, all of them among the long tests."""

import json

import pytest
from click.testing import CliRunner

from twin.cli.safety import safety
from twin.devices.akd.conditions import CONDITIONS as DRIVE_CONDITIONS
from twin.devices.lumio.conditions import CONDITIONS as SCREEN_CONDITIONS
from twin.devices.realtime import TIMING_CONDITIONS
from twin.hal.faults import Severity
from twin.hal.supervisor import RIG_CONDITIONS
from twin.safety.cases import CASES
from twin.safety.doc import write_doc
from twin.safety.matrix import run_case

QUICK = (
    "The bit rate is wrong",
    "The CAN adapter is pulled",
    "The ball is lifted (pen-up)",
)
NUMBER = {case.name: index for index, case in enumerate(CASES)}


@pytest.mark.parametrize("name", QUICK)
def test_a_fault_is_detected_in_time_answered_safely_recorded_and_recovered_from(name):
    row = run_case(NUMBER[name])
    assert row.good, row


@pytest.mark.long
@pytest.mark.parametrize("name", [case.name for case in CASES if case.name not in QUICK])
def test_every_fault_of_the_matrix_is_mastered(name):
    row = run_case(NUMBER[name])
    assert row.good, row


def test_names_of_the_cases_are_all_different():
    assert len(NUMBER) == len(CASES)


def test_a_run_that_nothing_happens_to_would_fail_a_row(monkeypatch):
    case = CASES[NUMBER["The STO input of drive phi opens"]]
    idle = type(case)(name="nothing", act=lambda rig: None, expected=case.expected)
    monkeypatch.setattr("twin.safety.matrix.CASES", (idle,))
    monkeypatch.setattr("twin.safety.matrix.BEGIN", 0.3)
    monkeypatch.setattr("twin.safety.matrix.AFTER", 0.3)
    row = run_case(0)
    assert row.detected is None
    assert not row.good


def test_the_document_has_every_condition_of_every_device(tmp_path):
    write_doc(tmp_path / "safety.md", [])
    text = (tmp_path / "safety.md").read_text()
    for condition in (*RIG_CONDITIONS, *TIMING_CONDITIONS, *SCREEN_CONDITIONS, *DRIVE_CONDITIONS):
        assert f"| {condition.name} | {condition.severity} |" in text
        assert condition.recovery in text


def test_every_condition_that_stops_or_levels_says_how_to_go_on():
    for condition in (*RIG_CONDITIONS, *TIMING_CONDITIONS, *SCREEN_CONDITIONS, *DRIVE_CONDITIONS):
        if condition.severity is not Severity.WARNING:
            assert condition.recovery not in {"", "none needed"}


def test_the_command_exits_with_1_if_a_row_is_bad(monkeypatch):
    row = type("Row", (), {"good": False, "as_dict": lambda self: {"good": False}})()
    monkeypatch.setattr("twin.cli.safety.run_all", lambda processes, progress: [row])
    done = CliRunner().invoke(safety, ["--json"], standalone_mode=False)
    assert json.loads(done.output[done.output.index("[") :]) == [{"good": False}]
    assert done.return_value == 1
