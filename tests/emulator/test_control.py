"""Tests of `twin.emulator.control`."""

import json
import socket
import sys
from pathlib import Path

import pytest

from twin.base.errors import RigError
from twin.emulator.can_bus import EmulatedBus
from twin.emulator.control import BusControl, ControlError, control_socket
from twin.emulator.drive import EmulatedDrive
from twin.emulator.drive_objects import Frame
from twin.emulator.fault_lines import CONTROL_COMMANDS
from twin.emulator.load import InertiaLoad
from twin.emulator.power_stage import Power
from twin.emulator.profile_drive import ProfileDrive

NEEDS_SOCKETS = pytest.mark.skipif(
    not hasattr(socket, "AF_UNIX"), reason=f"{sys.platform} has no Unix sockets in Python"
)


@pytest.fixture
def bus():
    made = EmulatedBus([EmulatedDrive(1), ProfileDrive(2, InertiaLoad())])
    made.step(0.001)
    made.to_host()
    return made


@pytest.fixture
def obey(bus):
    return BusControl(bus).obey


@pytest.mark.parametrize("node", [1, 2])
def test_a_fault_on_demand_is_an_emergency_and_a_state(bus, obey, node):
    obey(f"fault {node} 0x4310")
    bus.step(0.001)
    assert bus.drives[node - 1].state is Power.FAULT
    assert [frame.cob_id for frame in bus.to_host()] == [0x080 + node]


def test_a_lasting_fault_comes_back_until_it_is_restored(bus, obey):
    drive = bus.drives[1]
    obey("fault 2 0x4310 lasting")
    assert drive.power.standing == {0x4310}
    obey("restore 2")
    assert drive.power.standing == set()


def test_the_state_is_json(obey):
    obey("sto 2")
    found = json.loads(obey("state"))
    assert [each["node"] for each in found] == [1, 2]
    assert found[1]["state"] == "switch on disabled"
    assert found[1]["network"] == "pre-operational"


@pytest.mark.parametrize(
    ("line", "undo", "look"),
    [
        ("sto 2", "release 2", lambda drive: not drive.power.sto_closed),
        ("voltage 2 off", "voltage 2 on", lambda drive: not drive.power.dc_link),
        ("jam 2", "free 2", lambda drive: drive.motor.jammed),
        ("jam 2", "restore 2", lambda drive: drive.motor.jammed),
        ("torque 2 0.5", "torque 2 0", lambda drive: drive.motor.external == 0.5),
        ("sdo 2 silent", "sdo 2 answers", lambda drive: drive.sdo_silent),
        ("abort 2 0x6064 0x08000000", "restore 2", lambda drive: drive.sdo_aborts),
    ],
)
def test_a_line_does_something_and_another_undoes_it(bus, obey, line, undo, look):
    drive = bus.drives[1]
    assert not look(drive)
    obey(line)
    assert look(drive)
    obey(undo)
    assert not look(drive)


def test_a_drive_without_power_is_silent_and_boots_afterwards(bus, obey):
    obey("power 2 0.05")
    assert bus.drives[1].receive(Frame(0x602, b"\x40\x00\x10" + bytes(5))) == []
    for _ in range(60):
        bus.step(0.001)
    assert Frame(0x702, b"\0") in bus.to_host()


READ = Frame(0x602, b"\x40\x00\x10" + bytes(5))


@pytest.mark.parametrize(
    ("line", "count", "size"),
    [("drop 0x582 1", 0, 0), ("repeat 0x582 1", 2, 8), ("cut 0x582 3 1", 1, 3), ("drop 1 1", 1, 8)],
)
def test_frames_are_damaged_for_a_time(bus, obey, line, count, size):
    obey(line)
    bus.from_host(READ)
    frames = bus.to_host()
    assert len(frames) == count
    assert all(len(frame.data) == size for frame in frames)
    obey("clear")
    bus.from_host(READ)
    assert [len(frame.data) for frame in bus.to_host()] == [8]


def test_frames_are_delayed(bus, obey):
    obey("delay all 0.01 1")
    bus.from_host(READ)
    seen = []
    for step in range(1, 40):
        bus.step(0.001)
        seen += [step] * len(bus.to_host())
    assert seen == [20]  # request and answer are late by 10 ms each


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("jump 1", "known: state; fault NODE"),
        ("", "known: state"),
        ("fault 1", "how: fault NODE NUMBER"),
        ("fault 9 1", "no such drive; there are 1, 2"),
        ("fault x 1", "must be a whole number, 1 to 127"),
        ("fault 1 99999999", "must be a whole number, 1 to 65535"),
        ("power 1 nan", "must be a number, 0 to 86400"),
        ("power 1 -1", "must be a number"),
        ("jam 1", "turns a plate"),
        ("drop 0x800 1", "must be a whole number, 0 to 2047"),
        ("drop all", "how: drop"),
        ("torque 2 1 2", "how: torque"),
    ],
)
def test_a_line_that_cannot_be_obeyed_is_answered_in_one_line(obey, line, words):
    with pytest.raises(ControlError) as caught:
        obey(line)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_word_that_is_listed_is_known(obey):
    refused = []
    for each in CONTROL_COMMANDS:
        try:
            obey(each)
        except ControlError as error:
            refused.append(str(error))
    assert not [each for each in refused if each.startswith("known:")]


def test_every_word_is_described():
    page = Path(__file__).parents[2] / "docs" / "wire.md"
    text = page.read_text(encoding="utf-8")
    assert [each for each in CONTROL_COMMANDS if f"`{each.split()[0]}" not in text] == []


@NEEDS_SOCKETS
def test_lines_come_over_a_socket_for_its_owner_alone(obey, tmp_path):
    path = tmp_path / "control"
    with control_socket(path, obey):
        assert path.stat().st_mode & 0o777 == 0o600
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(path))
            client.sendall(b"sto 2\nnonsense\n")
            answers = client.makefile()
            assert answers.readline() == "ok: node 2: sto\n"
            assert answers.readline().startswith("error: known: state")
            answers.close()
        with pytest.raises(RigError, match="remove it if no emulator serves it"):
            control_socket(path, obey).__enter__()
    assert not path.exists()


@NEEDS_SOCKETS
def test_the_end_of_a_line_that_is_too_long_is_not_obeyed(obey, bus, tmp_path, capsys):
    path = tmp_path / "control"
    with control_socket(path, obey):
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(5)
            client.connect(str(path))
            client.sendall(b"x" * 200 + b"sto 1\n")
            with client.makefile() as answers:
                assert answers.readlines() == ["error: a line has at most 200 bytes\n"]
        for _ in range(20):  # who asks much and goes
            with socket.socket(socket.AF_UNIX) as client:
                client.connect(str(path))
                client.sendall(b"nonsense\n" * 500)
    assert bus.drives[0].power.sto_closed
    assert capsys.readouterr().err == ""
