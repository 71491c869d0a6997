"""`twin.emulator`.

What can be done to what is said on the wires: bits, frames of others, lost power, lateness."""

import pytest

from twin.emulator.can_bus import EmulatedBus, SlcanAdapter, Towards
from twin.emulator.drive import EmulatedDrive
from twin.emulator.drive_objects import Frame
from twin.emulator.power_stage import Power
from twin.emulator.screen import Damage, Protocol, ScreenFault, ScreenLine

READ = bytes.fromhex("4000100000000000")
"""Request of 1000h:0."""


@pytest.fixture
def bus():
    bus = EmulatedBus([EmulatedDrive(node) for node in (1, 2)])
    bus.step(0.001)
    bus.to_host()
    return bus


@pytest.mark.parametrize(
    ("at", "bits", "data"), [(0, 0x81, "820408"), (2, 4, "03040c"), (3, 1, "030408")]
)
def test_bits_of_one_byte_are_turned_over_where_the_frame_has_it(bus, at, bits, data):
    bus.faults.flip(0x181, at=at, bits=bits, towards=Towards.HOST)
    bus.from_other(Frame(0x181, bytes.fromhex("030408")))
    bus.from_other(Frame(0x182, bytes.fromhex("030408")))
    assert [frame.data.hex() for frame in bus.to_host()] == [data, "030408"]


@pytest.mark.parametrize(
    "frame", [Frame(0x601, READ, extended=True), Frame(0x601, READ, remote=True)], ids=repr
)
def test_a_drive_answers_neither_frames_of_29_bits_nor_remote_requests(bus, frame):
    bus.from_other(frame)
    assert bus.to_host() == [frame]
    bus.from_other(Frame(0x601, READ))
    assert [each.cob_id for each in bus.to_host()] == [0x601, 0x581]


def test_the_host_hears_a_command_of_another_master_before_what_it_leads_to(bus):
    bus.from_other(Frame(0x000, b"\x81\x00"))
    assert [each.cob_id for each in bus.to_host()] == [0x000, 0x701, 0x702]


@pytest.mark.parametrize(
    ("frame", "line"),
    [
        (Frame(0x100, b"\x11\x33"), b"t10021133\r"),
        (Frame(0x100, b"\x11\x33", extended=True), b"T0000010021133\r"),
        (Frame(0x100, bytes(2), remote=True), b"r1002\r"),
        (Frame(0x100, bytes(2), remote=True, extended=True), b"R000001002\r"),
    ],
    ids=repr,
)
def test_the_adapter_writes_every_kind_of_frame_as_the_manual_prints_it(bus, frame, line):
    adapter = SlcanAdapter(bus)
    adapter.feed(b"S8\rO\r")
    bus.from_other(frame)
    assert adapter.heard() == line


def test_a_drive_without_its_24_v_is_dead_and_then_as_after_power_up(bus):
    drive = bus.drives[0]
    drive.store.set(0x1016, 1, 0x7F003C)
    drive.motor.rate = 2.0
    drive.lose_power(0.05)
    assert not drive.power.live
    bus.step(0.04)
    bus.from_host(Frame(0x601, READ))
    assert bus.to_host() == []
    assert 0 < drive.rate < 2.0  # runs out without torque
    bus.step(0.02)
    bus.step(0.001)
    assert [(each.cob_id, each.data) for each in bus.to_host()] == [(0x701, b"\0")]
    assert drive.state is Power.SWITCH_ON_DISABLED
    assert drive.store.get(0x1016, 1) == 0
    bus.from_host(Frame(0x601, READ))
    assert [each.cob_id for each in bus.to_host()] == [0x581]


def reports(fault, seconds=2.0, begin=1.0, protocol=Protocol.HID_TIMED):
    """Arrival and scan times in s and places along x of reports; the fault comes at ``begin``."""
    line = ScreenLine(lambda: [(0.0, 0.0)], protocol=protocol, frame=0.02, dead_time=0.05)
    found = []
    for step in range(round(1000 * seconds)):
        now = step / 1000
        if now == begin:
            line.damage.inject(fault, 1e9)
        found += [
            (now, int.from_bytes(part[13:15], "little") * 1e-4, int.from_bytes(part[2:4], "little"))
            for part in line.step(now)
        ]
    return found


def test_a_scan_time_is_that_of_the_frame_and_precedes_the_arrival_by_the_dead_time():
    found = reports(ScreenFault.JUMP, begin=9.0)
    assert len(found) > 80
    assert [now - scan for now, scan, _ in found] == pytest.approx([0.05] * len(found), abs=2e-3)


def test_reports_that_come_later_keep_their_scan_time():
    now, scan, _ = reports(ScreenFault.LATER)[-1]
    assert now - scan - 0.05 == pytest.approx(Damage.LATER * (scan - 1.0), abs=5e-3)


def test_places_that_walk_away_go_on_evenly():
    first, last = (
        next(x for now, _, x in reports(ScreenFault.DRIFT) if now >= time) for time in (1.0, 1.9)
    )
    # the first of them was seen a dead time earlier, before the fault
    assert (last - first) / 32767 == pytest.approx(Damage.DRIFT * 0.85, abs=0.01)


def test_a_report_sent_again_and_again_has_its_place_and_its_scan_time():
    found = [each[1:] for each in reports(ScreenFault.REPEAT) if each[0] > 1.06]
    assert len(found) > 30
    assert len(set(found)) == 1


def test_a_scan_time_that_stands_still_leaves_the_places_alone():
    found = [each for each in reports(ScreenFault.TIME_STILL) if each[0] > 1.06]
    assert len({scan for _, scan, _ in found}) == 1
    assert [now for now, *_ in found] == pytest.approx(
        [found[0][0] + 0.02 * number for number in range(len(found))], abs=2e-3
    )


def test_what_is_on_its_way_is_dropped_with_the_damage():
    line = ScreenLine(lambda: [(0.0, 0.0)], protocol=Protocol.HID_TIMED, frame=0.02, dead_time=0.05)
    line.damage.inject(ScreenFault.LATER, 1e9)
    for step in range(1000):
        line.step(step / 1000)
    line.clear()
    assert [part for step in range(1000, 1045) for part in line.step(step / 1000)] == []
    assert [part for step in range(1045, 1080) for part in line.step(step / 1000)]
