"""Tests of `twin.view.bus`."""

import struct

import can
import pytest

from twin.devices.akd.decoding import Conversation
from twin.devices.akd.protocol import DriveState, table
from twin.view.bus import DRIVE_COLOURS, NETWORK_COLOURS, lanes, signals, write_bus

ENABLED, FAULT, SWITCHED_ON = 0x0637, 0x0638, 0x0633


def frame(at, identifier, data=b""):
    return can.Message(timestamp=at, arbitration_id=identifier, is_extended_id=False, data=data)


def trace():
    """Two drives for 0.4 s; node 1 goes into fault at 0.2 s, SYNC pauses for 10 ms at 0.3 s."""
    heard = [frame(0.0, 0x701, b"\x00"), frame(0.001, 0x701, b"\x7f"), frame(0.002, 0x701, b"\x05")]
    heard.append(frame(0.003, 0x702, b"\x05"))
    for k in range(200):
        at = 0.01 + 0.002 * k + (0.01 if k >= 145 else 0.0)
        heard.append(frame(at, 0x080))
        word = SWITCHED_ON if k < 20 else ENABLED if k < 95 else FAULT
        heard.append(frame(at + 0.0002, 0x381, struct.pack("<Hi", word, 10 * k)))
        heard.append(frame(at + 0.0004, 0x382, struct.pack("<Hi", ENABLED, -10 * k)))
    return heard


@pytest.fixture(scope="module")
def conversation():
    return Conversation(trace())


def test_lanes_show_states_of_network_and_drives_and_gaps_of_sync(conversation):
    found = {name: lane for name, lane, _ in lanes(conversation)}
    assert found["node 1 network"].states == ["booting", "pre-operational", "operational"]
    assert found["node 2 network"].states == ["operational"]
    drive = found["node 1 drive"]
    assert drive.states == ["switched on", "operation enabled", "fault"]
    assert drive.time == pytest.approx([0.0102, 0.0502, 0.2002])
    assert found["node 2 drive"].states == ["operation enabled"]
    assert found["SYNC"].states == ["regular", "late", "regular"]
    assert found["SYNC"].time == pytest.approx([0.01, 0.298, 0.31])


def test_every_state_of_the_standards_has_a_colour():
    unseen = {DriveState.NOT_READY, DriveState.UNKNOWN}
    assert set(DRIVE_COLOURS) == {each.value for each in set(DriveState) - unseen}
    assert set(NETWORK_COLOURS) == set(table()["nmt_states"].values())


def test_signals_are_what_pdos_carry_without_words(conversation):
    found = signals(conversation)
    assert list(found) == ["6064h Position actual"]
    time, values = found["6064h Position actual"]["node 2"]
    assert values.tolist() == [-10 * k for k in range(200)]
    assert time[0] == pytest.approx(0.0104)


def test_a_trace_is_a_recording_that_the_viewer_takes(conversation, tmp_path, printed):
    write_bus(tmp_path / "bus.rrd", conversation, "bus")
    text = printed(tmp_path / "bus.rrd")
    for entity in ("states/node_1_drive", "states/SYNC", "events", "Position"):
        assert entity in text


def test_view_takes_a_trace_in_place_of_a_run(tmp_path, ballplate, printed):
    lines = [
        f"({each.timestamp:.6f}) can0 {each.arbitration_id:03X}#{each.data.hex().upper()}"
        for each in trace()
    ]
    (tmp_path / "bus.log").write_text("\n".join(lines) + "\n")
    target = tmp_path / "bus.rrd"
    code, _, err = ballplate("view", tmp_path / "bus.log", "--rrd", target)
    assert (code, err) == (0, "")
    assert "node_1_drive" in printed(target)
    code, _, err = ballplate("view", tmp_path / "bus.log", tmp_path, "--rrd", tmp_path / "no.rrd")
    assert code == 2
    assert err == f"ballplate: {tmp_path}/bus.log: not a run; show a CAN trace without runs\n"
    (tmp_path / "other.log").write_text("no trace\n")
    code, _, err = ballplate("view", tmp_path / "other.log", "--rrd", tmp_path / "no.rrd")
    assert (code, err.count("\n"), (tmp_path / "no.rrd").exists()) == (2, 1, False)
