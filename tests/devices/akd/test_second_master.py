"""`twin.devices.akd`.

Another master on the bus, before the host starts and while it runs."""

import struct

import can
import pytest
from stepped import SteppedDrives

from twin.devices.akd import conditions as c
from twin.devices.akd.bus import CanTransport
from twin.devices.akd.conditions import DriveError
from twin.devices.common import FaultReports
from twin.emulator.drive_objects import Frame
from twin.emulator.power_stage import Power

RATE = struct.Struct("<Hi").pack(0x0F, round(1.2 * 9549.297))
"""RPDO1: enabled, 1.2 rad/s."""

FRAMES = {
    "SYNC": (Frame(0x080), 0.002),
    "heartbeat": (Frame(0x77F, b"\x05"), 0.02),
    "RPDO1": (Frame(0x201, RATE), 0.002),
    "RPDO4": (Frame(0x502, RATE), 0.002),
    "NMT": (Frame(0x000, b"\x01\x00"), 0.05),
    "SDO": (Frame(0x601, bytes.fromhex("4000100000000000")), 0.05),
}
"""What the other one sends, and how often in s."""


def other_master(rig, kind):
    """Let another master send from now on; before or after whatever the host has to say."""
    frame, every = FRAMES[kind]
    moved, due = rig.bus.moved, [rig.bus.time]

    def move(dt):
        moved(dt)
        if rig.bus.time >= due[0]:
            due[0] += every
            rig.bus.from_other(frame)

    rig.bus.moved = move


@pytest.fixture
def rig():
    with SteppedDrives() as rig:
        yield rig


@pytest.mark.parametrize("kind", FRAMES)
def test_a_start_beside_another_master_is_refused_before_anything_is_sent(rig, kind):
    other_master(rig, kind)
    sent = []
    from_host = rig.bus.from_host
    rig.bus.from_host = lambda frame: sent.append(frame) or from_host(frame)
    with pytest.raises(DriveError, match="a second master sends") as caught:
        rig.servos.start()
    assert caught.value.fault.condition == c.SECOND_MASTER
    assert kind in str(caught.value)
    assert not sent


def test_a_master_that_appears_during_the_start_is_found_at_its_end(rig):
    from_host = rig.bus.from_host

    def meddle(frame):
        if frame.cob_id == 0x000 and frame.data[0] == 1:  # the host starts a drive
            rig.bus.from_other(FRAMES["SYNC"][0])
        return from_host(frame)

    rig.bus.from_host = meddle
    with pytest.raises(DriveError, match="SYNC"):
        rig.servos.start()


@pytest.mark.short("NMT", "SYNC", "RPDO1")
@pytest.mark.parametrize("kind", FRAMES)
def test_another_master_in_mid_run_stops_the_drives_and_is_named(rig, kind):
    rig.enabled()
    rig.run(0.1, lambda _: (0.3, 0.3))
    other_master(rig, kind)
    begin = rig.bus.time
    seen = rig.run(0.6, lambda _: (0.3, 0.3))
    found = next(each for each in seen if each.condition == c.SECOND_MASTER)
    assert found.at - begin <= c.SECOND_MASTER.within
    assert kind in found.detail
    assert not rig.servos.enabled
    # one that goes on commanding overrules the quick stop: the heartbeat is withheld then
    assert all(drive.state is not Power.OPERATION_ENABLED for drive in rig.drives)
    assert all(abs(drive.rate) < 0.01 for drive in rig.drives)


def test_an_own_frame_that_the_adapter_hands_back_is_no_other_master_s():
    with can.Bus(interface="virtual", channel="echo", receive_own_messages=True) as bus:
        transport = CanTransport(bus, "CAN echo", FaultReports(1.0), lambda: 0.0)
        transport.send(0x080, b"")
        assert list(transport.receive(1.0)) == []
