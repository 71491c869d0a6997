"""`twin.devices.akd.traces`.

Traces are written and read again: every format, broken ones, ours and other people's."""

from copy import copy
from itertools import pairwise

import can
import can.interfaces.virtual
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.base.errors import LogError
from twin.devices.akd.recording import TracedBus, TraceWriter, from_row, to_row
from twin.devices.akd.traces import WRITTEN_SUFFIXES, check_ending, parts, read_trace

MESSAGES = st.builds(
    can.Message,
    timestamp=st.floats(0, 2e9),
    arbitration_id=st.integers(0, 0x7FF),
    is_extended_id=st.booleans(),
    is_rx=st.booleans(),
    data=st.binary(max_size=8),
)


def frame(identifier, data, at, **more):
    return can.Message(
        timestamp=at, arbitration_id=identifier, is_extended_id=False, data=data, **more
    )


HEARD = [
    frame(0x000, b"\x01\x05", 1.5, is_rx=False),
    frame(0x705, b"\x05", 1.525),
    frame(0x185, bytes(range(8)), 1.5261, is_rx=True),
    frame(0x080, b"", 1.75, is_rx=False),
]


def write_trace(file, messages=HEARD, part=None):
    writer = TraceWriter(file, "can0", part)
    for message in messages:
        writer.write([message])
    writer.close()
    return file


@given(MESSAGES)
def test_a_frame_comes_back_from_its_numbers(message):
    again = from_row(*map(float, to_row(message)))
    assert again.equals(message, timestamp_delta=None, check_channel=False)
    assert again.timestamp == message.timestamp


@pytest.mark.parametrize("ending", [*WRITTEN_SUFFIXES, ".log.gz", ".asc.gz", ".csv.gz", ".trc.gz"])
def test_what_is_written_in_a_format_is_read_again(tmp_path, ending):
    found = read_trace(write_trace(tmp_path / f"a{ending}"))
    assert not found.remarks
    assert [each.arbitration_id for each in found.frames] == [0x000, 0x705, 0x185, 0x080]
    assert [bytes(each.data) for each in found.frames] == [bytes(each.data) for each in HEARD]
    begin = found.frames[0].timestamp
    passed = [each.timestamp - begin for each in found.frames]
    assert passed == pytest.approx([0, 0.025, 0.0261, 0.25], abs=1e-4)


def test_a_broken_line_costs_one_frame(tmp_path):
    file = write_trace(tmp_path / "a.log")
    lines = file.read_text().splitlines()
    lines[1] = lines[1][:-4] + "0 R"
    file.write_text("\n".join([*lines, "(1.76) can0 0", "", "(1.8) can0 081##10102", ""]))
    found = read_trace(file)
    assert [each.arbitration_id for each in found.frames] == [0x000, 0x185, 0x080]
    assert found.remarks == ["a.log: left out: 3 lines without a classic frame of candump -L"]


@pytest.mark.short(".blf", ".csv")
@pytest.mark.parametrize("ending", [".asc", ".blf", ".csv", ".log.gz"])
def test_of_a_truncated_trace_what_is_left_is_read(tmp_path, ending):
    many = [frame(0x181, k.to_bytes(4, "little"), 1 + 0.002 * k) for k in range(20_000)]
    file = tmp_path / f"a{ending}"
    writer = TraceWriter(file, "can0")
    writer.write(many)
    writer.close()
    file.write_bytes(file.read_bytes()[:-1001])
    found = read_trace(file)
    assert 10_000 < len(found.frames) < 20_000
    assert [bytes(each.data) for each in found.frames] == [
        bytes(each.data) for each in many[: len(found.frames)]
    ]
    if ending in {".blf", ".log.gz"}:  # of text the last line is whole or not
        assert len(found.remarks) == 1


def test_of_several_channels_one_is_told_and_the_others_are_named(tmp_path):
    other = "(1.6) vcan7 123#00 R\n"
    file = write_trace(tmp_path / "a.log")
    file.write_text(file.read_text() + other)
    found = read_trace(file)
    assert len(found.frames) == len(HEARD)
    assert found.remarks == ["channel can0 is shown (4 frames); others: vcan7 (1)"]
    assert len(read_trace(file, "vcan7").frames) == 1
    with pytest.raises(LogError, match="can0, vcan7"):
        read_trace(file, "can5")


def test_frames_out_of_order_are_told_in_order(tmp_path):
    file = write_trace(tmp_path / "a.csv", [HEARD[3], *HEARD[:3]])
    found = read_trace(file)
    assert [each.arbitration_id for each in found.frames] == [0x000, 0x705, 0x185, 0x080]
    assert "time goes back, by up to 0.25 s" in found.remarks[0]


# python-can leaves a file open whose header is wrong
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("name", ["a.log", "a.blf", "a.asc", "a.trc", "a.txt"])
def test_what_is_no_trace_is_told_in_one_line(tmp_path, name):
    (tmp_path / name).write_bytes(b"PK\x03\x04 nothing of the kind\n" * 9)
    with pytest.raises(LogError, match=name) as caught:
        read_trace(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_a_bounded_trace_keeps_its_beginning_and_its_end(tmp_path):
    file = tmp_path / "trace.log"
    many = [frame(0x181, k.to_bytes(4, "little"), 1 + 0.002 * k) for k in range(600)]
    write_trace(file, many, part=4000)
    assert len(parts(file)) == 3
    assert sum(each.stat().st_size for each in parts(file)) < 13_000
    found = read_trace(file)
    numbers = [int.from_bytes(each.data, "little") for each in found.frames]
    assert numbers[0] == 0
    assert numbers[-1] == 599
    jumps = [b - a for a, b in pairwise(numbers) if b - a != 1]
    assert len(jumps) == 1
    assert not found.remarks
    write_trace(file)
    assert parts(file) == [file]


def test_a_trace_that_is_named_takes_no_other_file_for_its_part(tmp_path):
    other = write_trace(tmp_path / "a-1.log")
    write_trace(tmp_path / "a.log", HEARD[:1])
    assert other.exists()
    assert len(read_trace(tmp_path / "a.log").frames) == 1


def test_a_bus_that_is_traced_tells_every_frame_once():
    heard = []
    with (
        can.Bus(interface="virtual", channel="traced") as other,
        TracedBus(can.Bus(interface="virtual", channel="traced"), heard.append) as bus,
    ):
        bus.send(copy(HEARD[0]))  # which gets the time of now
        other.send(copy(HEARD[2]))
        message = bus.recv(1.0)
        assert bus.recv(0.0) is None
    assert message is heard[1]
    assert [(each.arbitration_id, each.is_rx) for each in heard] == [(0x000, False), (0x185, True)]
    assert 0 <= heard[1].timestamp - heard[0].timestamp < 1


@pytest.mark.parametrize("name", ["a.mf4", "a.db", "a", "a.gz", "a.txt", "a.blf.gz"])
def test_an_ending_that_is_not_written_is_refused(tmp_path, name):
    with pytest.raises(LogError, match=r"\.blf"):
        check_ending(tmp_path / name)


def test_a_bus_that_is_traced_queues_frames_only_if_it_does_so_itself():
    class Queuing(can.interfaces.virtual.VirtualBus):
        unreadable_lines = 3
        sent = 0

        def send_queued(self):
            self.sent += 1

    with (
        TracedBus(can.Bus(interface="virtual"), print) as plain,
        TracedBus(Queuing("queue"), print) as queuing,
    ):
        assert not hasattr(plain, "send_queued")
        queuing.send_queued()
        assert (queuing.sent, queuing.unreadable_lines) == (1, 3)
