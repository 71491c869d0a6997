"""`twin.emulator.serve`: plain CiA 402 drives on a plate, and the command that serves them."""

import json
import os
import signal
import socket
import subprocess
import sys

import canopen
import numpy as np
import pytest
from canopen.profiles.p402 import BaseNode402
from click.testing import CliRunner

from twin.base.errors import TwinError
from twin.base.jobs import wait_until
from twin.cli.rig import emulate
from twin.devices.akd.eds import read_data_sheet
from twin.emulator.bus_name import BusName
from twin.emulator.can_bus import EmulatedBus
from twin.emulator.drive import EmulatedDrive
from twin.emulator.load import ShaftLoad
from twin.emulator.profile_drive import COUNT_RAD, ProfileDrive
from twin.emulator.profile_eds import eds_text
from twin.emulator.serve import EmulatedPlant, VirtualRig
from twin.scenario.rig import check_rig


def write(drive, index, value):
    drive.store.set(index, 0, value)
    drive._written(index, 0)


def test_plain_drives_turn_the_plate_to_where_its_cams_have_it(scenario):
    plant = EmulatedPlant(scenario())
    drives = [ProfileDrive(node, ShaftLoad()) for node in (1, 2)]
    bus = EmulatedBus(drives)
    plant.attach(drives)
    bus.moved = plant.advance
    goals = plant.transmission.motor(np.radians([[1.0, -0.5]]))[0]
    for drive, goal in zip(drives, goals, strict=True):
        for index, value in ((0x6060, 1), (0x6081, 20000), (0x6083, 200000), (0x6084, 200000)):
            write(drive, index, value)
        for word in (0x06, 0x07, 0x0F):
            write(drive, 0x6040, word)
        write(drive, 0x607A, round(goal / COUNT_RAD))
        write(drive, 0x6040, 0x1F)
    for _ in range(1500):
        bus.step(0.001)
    assert [bool(drive.status & 1 << 10) for drive in drives] == [True, True]
    assert np.degrees(plant.devices.plate()[0]) == pytest.approx([1.0, -0.5], abs=0.02)


def test_the_file_of_a_rig_on_another_bus_names_it_and_its_nodes(scenario):
    drives = [EmulatedDrive(node) for node in (5, 6)]
    with VirtualRig(scenario(), drives=drives, name=BusName("virtual", "wire")) as rig:
        tables = rig.tables()
        assert tables["bus"] == {"interface": "virtual", "channel": "wire", "options": {}}
        assert (tables["phi"], tables["theta"]) == ({"node": 5}, {"node": 6})
        check_rig(tables, "tables")


def test_a_rig_obeys_lines_about_its_plate_and_about_its_drives(scenario):
    with VirtualRig(scenario(), name=BusName("virtual", "lines")) as rig:
        assert rig.obey("sto") == "STO open: both drives without torque"
        assert [drive.power.sto_closed for drive in rig.drives] == [False, False]
        assert rig.obey("release 2") == "node 2: release"
        assert [drive.power.sto_closed for drive in rig.drives] == [False, True]
        assert "turns a plate" in rig.obey("jam 1")
        refusal = rig.obey("jump")
        assert refusal.startswith("known: sto, release, lift, put, unplug, plug, touch X Y, lag; ")
        assert "fault NODE NUMBER" in refusal


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--bus nope:1", "unknown CAN interface 'nope'"),
        ("--bus udp_multicast:1.2.3.4", "not an IP multicast address"),
        ("--bus slcan:/dev/ttyNO", "no channel '/dev/ttyNO'"),
        ("--node 3 --node 3", "each drive needs a different node"),
        ("--node 3", "name two nodes"),
        ("--mechanism inertia", "needs --drive cia402"),
        ("--mechanism inertia --drive cia402 --set duration=3", "--set: changes"),
        ("--drive cia402 --write x.toml", "--write: a rig file is for AKD drives only"),
        ("--bus udp_multicast --write x.toml", "and not for udp_multicast"),
        ("--drive cia402 --mechanism inertia --bus virtual:a --control /no/x", "cannot be made"),
        ("--drive akd --eds x.eds", "--eds: needs --drive cia402"),
    ],
)
def test_options_that_cannot_be_are_refused_in_one_line(options, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(emulate, options.split())
    assert isinstance(done.exception, TwinError)
    assert words in str(done.exception)
    assert "\n" not in str(done.exception)
    assert not list(tmp_path.iterdir())


def test_the_eds_is_written_without_serving(tmp_path):
    file = tmp_path / "drive.eds"
    done = CliRunner().invoke(emulate, ["--eds", str(file)])
    assert done.exit_code == 0
    assert file.read_text() == eds_text()
    assert read_data_sheet(file).objects


SERVE = "import sys; from twin.cli import main; raise SystemExit(main())"


@pytest.mark.long
@pytest.mark.real_time
@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="no Unix sockets in Python here")
def test_a_foreign_master_drives_the_command_over_its_pty_and_a_socket_brings_faults(tmp_path):
    control, eds = tmp_path / "control", tmp_path / "drive.eds"
    eds.write_text(eds_text())
    options = ["--drive", "cia402", "--mechanism", "inertia", "--node", "9"]
    with subprocess.Popen(
        [sys.executable, "-c", SERVE, "emulate", *options, "--control", str(control)],
        stdout=subprocess.PIPE,
        stdin=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            line = process.stdout.readline()
            assert line.startswith("cia402 drives, node 9, on slcan:")
            channel = line.split("slcan:")[1].split(";")[0]
            network = canopen.Network()
            network.connect(
                interface="slcan", channel=channel, bitrate=1_000_000, sleep_after_open=0.0
            )
            try:
                node = network.add_node(BaseNode402(9, str(eds)))
                node.sdo.RESPONSE_TIMEOUT = 5.0
                assert node.sdo[0x1008].raw == "Emulated CiA 402 drive"
                with socket.socket(socket.AF_UNIX) as client:
                    client.connect(str(control))
                    client.sendall(b"fault 9 0x4310\nstate\n")
                    answers = client.makefile()
                    assert answers.readline() == "ok: node 9: fault 0x4310\n"
                    state = json.loads(answers.readline().removeprefix("ok: "))[0]
                    answers.close()
                assert state["state"] == "fault"
                assert wait_until(lambda: node.emcy.log, 60.0)
                assert node.emcy.log[0].code == 0x4310
            finally:
                network.disconnect()
            os.kill(process.pid, signal.SIGINT)
            assert process.wait(20.0) == 0
        finally:
            process.kill()
    assert not control.exists()
