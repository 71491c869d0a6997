"""Tests of `twin.emulator.injection` and `twin.emulator.fault_lines`."""

import re
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from twin.base.errors import ScenarioError
from twin.base.jobs import wait_until
from twin.emulator.fault_lines import FAULTS, MATRIX_ROWS, fault_name, plan_faults
from twin.emulator.injection import INJECTED, inject
from twin.hal.supervisor import State
from twin.scenario import load


def test_faults_come_in_the_order_of_their_times():
    planned = plan_faults(["3 unplug", "0.5 drop 0x080 0.1", " 1.25  sto 2 "], 5.0, "--fault")
    assert [each[:2] for each in planned] == [
        (0.5, "drop 0x080 0.1"),
        (1.25, "sto 2"),
        (3.0, "unplug"),
    ]


@pytest.mark.parametrize("name", FAULTS)
def test_every_name_stands_for_a_line_that_the_virtual_rig_obeys(name):
    (planned,) = plan_faults([f"2.5 {name}"], 5.0, "--fault")
    assert planned == (2.5, FAULTS[name], name)


def test_the_page_has_every_name_and_no_other():
    page = (Path(__file__).parents[2] / "docs" / "connect.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([^`]+)` \| `([^`]+)` \| (.*?) \|$", page, re.MULTILINE)
    shown = {name: line for name, line, _ in rows if name in FAULTS}
    assert shown.items() <= FAULTS.items()
    assert shown.keys() | {name.replace("phi", "theta") for name in shown} == FAULTS.keys()
    assert {name: row for name, _, row in rows if row != "-" and name in shown} == MATRIX_ROWS


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("sync lost", "SYNC lost"),
        ("measurements of phi lost", "PDOs of drive phi lost"),
        ("drive of theta reboots", "drive theta rebooted"),
        ("Ball  Lifted", "ball lifted"),
        ("unplug", None),
    ],
)
def test_former_names_and_other_letters_name_the_same_fault(text, name):
    assert fault_name(text) == name
    (planned,) = plan_faults([f"1 {text}"], 5.0, "--fault")
    assert planned.name == (name or text)


def test_faults_of_drives_are_those_of_the_named_axis():
    nodes = {"phi": "1", "theta": "2"}
    for name, line in FAULTS.items():
        axis = next((each for each in nodes if f" {each}" in f" {name}"), None)
        if axis is not None:
            assert line.split()[1][-1] == nodes[axis], name


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("unplug", "write 'SECONDS LINE', as in '3.0 unplug', with 0 to 5 seconds"),
        ("5 unplug", "the time must be 0 to 5 s, got 5"),
        ("-1 unplug", "the time must be 0 to 5 s, got -1"),
        ("nan unplug", "with 0 to 5 seconds"),
        ("1 unplg", "no fault 'unplg'; did you mean 'unplug'?"),
        ("1", "write 'SECONDS LINE', as in '3.0 unplug', with 0 to 5 seconds"),
        ("1 SYNC lots", "no fault 'SYNC lots'; did you mean 'SYNC lost'?"),
        ("1 touch 1", "how: touch X Y, in mm"),
        ("1 touch nan 0", "'nan': must be a number, -1000 to 1000"),
        ("1 drop", "how: drop ID|all SECONDS"),
        ("1 drop 0x080", "how: drop ID|all SECONDS"),
        ("1 drop 0x080 nan", "'nan': must be a number, 0 to 86400"),
        ("1 drop 99999 1", "'99999': must be a whole number, 0 to 2047"),
        ("1 sto 3", "node 3: no such drive; there are 1, 2"),
        ("1 jam 1", "turns a plate"),
        ("1 lift 3", "how: lift"),
    ],
)
def test_a_fault_that_cannot_be_planned_is_one_line(text, words):
    with pytest.raises(ScenarioError) as caught:
        plan_faults([text], 5.0, "--fault")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


class Running:
    """A rig whose clock goes on by itself once it runs."""

    def __init__(self):
        self.begin = None
        self.journal = []
        self.supervisor = SimpleNamespace(state=[State.READY])
        self.clock = self

    def start(self):
        self.begin = time.monotonic()
        self.supervisor.state[0] = State.RUNNING

    @property
    def time(self):
        return time.monotonic() - self.begin if self.begin is not None else 99.0


def test_each_fault_is_done_once_at_its_time_of_the_run_and_noted():
    rig, obeyed = Running(), []

    def obey(line):
        obeyed.append((rig.time, line))
        return "done"

    planned = plan_faults(["0.05 unplug", "0.1 plug", "900 sto"], 1000.0, "--fault")
    with inject(planned, obey, rig):
        time.sleep(0.05)
        assert obeyed == []  # nothing before the run, whatever its clock shows
        rig.start()
        assert wait_until(lambda: len(obeyed) == 2, 60.0)
    assert [line for _, line in obeyed] == ["unplug", "plug"]  # the run ended before the third
    assert obeyed[0][0] >= 0.05
    assert obeyed[1][0] >= 0.1
    assert [entry.note.condition for entry in rig.journal] == [INJECTED, INJECTED]
    assert rig.journal[0].note.text == "virtual rig: unplug: done"


def test_without_faults_there_is_no_thread():
    rig = Running()
    with inject([], lambda _: "", rig):
        rig.start()
    assert rig.journal == []


def test_the_scenario_of_the_page_is_whole_and_has_its_fault(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "connect.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"```toml\n(.*?\[\[fault\]\].*?)```", page, re.DOTALL)
    (tmp_path / "faulty.toml").write_text(shown, encoding="utf-8")
    (fault,) = load(str(tmp_path / "faulty.toml")).fault
    assert (fault.at, fault.name) == (3.0, "SYNC lost")
    assert fault_name(fault.name) in FAULTS
