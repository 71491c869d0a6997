"""`twin.devices.akd.bus`: Frames between transport and adapter, on a pseudo-terminal.

The host's own bus is given the lines that the maker's CAN232 manual (version 3) prints, and any
bytes; of the emulated adapter it knows nothing.

A terminal hands over what is written in pieces, some later than the next read where the machine is
busy: all that a program has written is known only once something written after it has come.
"""

import errno
import os
import select
import time
from contextlib import contextmanager
from types import SimpleNamespace

import can
import pytest
from can.interfaces.slcan import slcanBus
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.devices.akd.bus import CanTransport, PromptSlcanBus, open_bus
from twin.devices.akd.conditions import (
    ADAPTER_GONE,
    BUS_OFF,
    ERROR_PASSIVE,
    FOREIGN_FRAME,
    GARBLED,
    DriveError,
)
from twin.devices.akd.config import BusConfig
from twin.devices.common import FaultReports


def transport_on(bus):
    reports = FaultReports(1.0)
    return CanTransport(bus, "CAN test", reports, lambda: 0.0), reports


@contextmanager
def terminal():
    """The adapter's end of a serial line, and the computer's."""
    tty = pytest.importorskip("tty")
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        yield master, slave
    finally:
        os.close(master)
        os.close(slave)


@pytest.fixture
def serial_line():
    with terminal() as line:
        yield line


END = b"#"
"""What no adapter is sent."""


def read_new_bytes(line):
    """All that has been written to the line since the last call, and not a byte more."""
    master, slave = line
    os.write(slave, END)
    data = b""
    while not data.endswith(END):
        assert select.select([master], [], [], 10.0)[0], f"only {data!r} has come"
        data += os.read(master, 100)
    return data.removesuffix(END)


def slcan_on(line):
    options = {"sleep_after_open": 0.0}
    return BusConfig(interface="slcan", channel=os.ttyname(line[1]), options=options)


@contextmanager
def slcan(kind, line):
    with kind(os.ttyname(line[1]), bitrate=1_000_000, sleep_after_open=0.0) as bus:
        assert read_new_bytes(line).endswith(b"O\r")
        yield bus


def play(line, bus, lines):
    """Every message that a bus makes of some bytes."""
    os.write(line[0], lines)
    end = time.monotonic() + 60.0
    while bus.serialPortOrig.in_waiting < len(lines):
        assert time.monotonic() < end, f"of {lines!r} not all arrived"
        time.sleep(1e-4)
    heard, message = [], bus.recv(0)
    while message is not None:
        heard.append(message)
        message = bus.recv(0)
    return heard


def frames(messages):
    """Identifiers and data of messages that are plain data frames."""
    for each in messages:
        odd = (each.is_extended_id, each.is_error_frame, each.is_remote_frame, each.is_fd)
        assert not any(odd), each
    return [(each.arbitration_id, bytes(each.data)) for each in messages]


def test_the_prompt_bus_writes_all_frames_of_a_period_in_one_piece(serial_line, monkeypatch):
    pieces, write = [], os.write
    monkeypatch.setattr(os, "write", lambda line, data: pieces.append(data) or write(line, data))
    with slcan(PromptSlcanBus, serial_line) as bus:
        transport, reports = transport_on(bus)
        transport.send(0x201, b"\x0f\x00")
        transport.send(0x080, b"")
        assert read_new_bytes(serial_line) == b""
        pieces.clear()
        transport.send_queued()
        assert pieces == [b"t20120F00\rt0800\r"]
        assert read_new_bytes(serial_line) == pieces[0]
        bus.unreadable_lines = 3
        assert list(transport.receive()) == []
        assert [(f.condition, f.detail) for f in reports.take()] == [
            (GARBLED, "3 lines cannot be read")
        ]


def test_a_second_opener_of_an_adapter_is_refused_before_it_sends_a_byte(serial_line):
    with slcan(PromptSlcanBus, serial_line):
        with pytest.raises(DriveError, match="is used by another program"):
            open_bus(slcan_on(serial_line))
        assert read_new_bytes(serial_line) == b""
    assert read_new_bytes(serial_line) == b"C\r"
    open_bus(slcan_on(serial_line)).shutdown()


@pytest.mark.parametrize(("platform", "kind"), [("linux", PromptSlcanBus), ("win32", slcanBus)])
def test_slcan_is_the_library_s_own_where_ports_have_no_descriptor(
    monkeypatch, serial_line, platform, kind
):
    monkeypatch.setattr("twin.devices.akd.bus.sys.platform", platform)
    with open_bus(slcan_on(serial_line)) as bus:
        assert type(bus) is kind
        assert b"S8\r" in read_new_bytes(serial_line)


def test_frames_pass_over_the_library_s_own_slcan_bus(serial_line):
    with slcan(slcanBus, serial_line) as bus:
        transport, _ = transport_on(bus)
        for period in range(5):
            os.write(serial_line[0], b"t1811%02X\rt1821%02X\r" % (period, period))
            transport.send(0x080, b"")
            transport.send_queued()
            data = bytes((period,))
            received = list(transport.receive(10.0))
            received += [] if len(received) > 1 else transport.receive(10.0)
            assert received == [(0x181, data), (0x182, data)]
        assert read_new_bytes(serial_line) == b"t0800\r" * 5


def test_our_host_opens_an_adapter_with_the_commands_of_the_manual(serial_line):
    with open_bus(slcan_on(serial_line)):
        commands = read_new_bytes(serial_line).split(b"\r")
    # Closed before it is set up, then open; more C, O and empty lines do no harm.
    assert commands.index(b"C") < commands.index(b"S8") < commands.index(b"O")
    assert set(commands) <= {b"C", b"S8", b"O", b""}


def test_our_host_transmits_as_the_manual_says(serial_line):
    with slcan(PromptSlcanBus, serial_line) as bus:
        bus.send(can.Message(arbitration_id=0x100, data=b"\x11\x33", is_extended_id=False))
        bus.send(can.Message(arbitration_id=0x20, is_extended_id=False))
        bus.recv(0)
        # The examples of the command t in the manual, and the question for the status flags.
        assert read_new_bytes(serial_line) == b"t10021133\rt0200\rF\r"


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        (b"t10021133\r", (0x100, b"\x11\x33")),
        (b"t0200\r", (0x20, b"")),
        (b"t100211334D67\r", (0x100, b"\x11\x33")),
        (b"z\r\rt10021133\r", (0x100, b"\x11\x33")),
        (b"V1013\rt0200\r", (0x20, b"")),
        (b"NA123\rt0200\r", (0x20, b"")),
        (b"F00\rt0200\r", (0x20, b"")),
        (b"\at0200\r", (0x20, b"")),
    ],
    ids=repr,
)
def test_our_host_reads_the_lines_that_the_manual_prints(serial_line, line, frame):
    with slcan(PromptSlcanBus, serial_line) as bus:
        assert frames(play(serial_line, bus, line)) == [frame]


@pytest.mark.parametrize(
    ("flags", "identifier"),
    # Of the manual's bits: 0 receive queue full, 1 transmit queue full, 2 error warning, 3 data
    # overrun, 5 error passive, 6 arbitration lost, 7 bus error.
    [
        *((1 << bit, None) for bit in (0, 1, 2, 3, 6)),
        (1 << 5, 0x004),
        (1 << 7, 0x080),
        (0xA4, 0x004),
    ],
)
def test_our_host_makes_error_frames_of_the_manual_s_status_bits(serial_line, flags, identifier):
    with slcan(PromptSlcanBus, serial_line) as bus:
        heard = play(serial_line, bus, b"F%02X\r" % flags)
        assert [each.arbitration_id for each in heard] == ([identifier] if identifier else [])
        assert all(each.is_error_frame for each in heard)


@given(st.lists(st.binary(max_size=40), max_size=6))
@settings(max_examples=40)
def test_our_host_takes_any_bytes_of_an_adapter(chunks):
    with terminal() as line, slcan(PromptSlcanBus, line) as bus:
        for message in (each for chunk in chunks for each in play(line, bus, chunk)):
            assert len(message.data) <= 8
            last = 0x1FFFFFFF if message.is_extended_id else 0x7FF
            assert message.is_error_frame or 0 <= message.arbitration_id <= last


@pytest.mark.parametrize(
    ("line", "identifier", "extended", "remote", "words"),
    [
        (b"T0000010021133", 0x100, True, False, "100h of 29 bits"),
        (b"r1002", 0x100, False, True, "remote request for 100h"),
        (b"r1000", 0x100, False, True, "remote request for 100h"),
        (b"R000001002", 0x100, True, True, "100h of 29 bits"),
        (b"r18121234", 0x181, False, True, "remote request for 181h"),  # with a time stamp
        (b"T0000018121133ABCD", 0x181, True, False, "181h of 29 bits"),
        (b"T1FFFFFFF0", 0x1FFFFFFF, True, False, "1FFFFFFFh of 29 bits"),
    ],
)
def test_frames_of_29_bits_and_remote_requests_are_known_as_that_and_not_read(
    serial_line, line, identifier, extended, remote, words
):
    with slcan(PromptSlcanBus, serial_line) as bus:
        heard, plain = play(serial_line, bus, line + b"\rt18222B3C\r")
        flags = (heard.arbitration_id, heard.is_extended_id, heard.is_remote_frame)
        assert flags == (identifier, extended, remote)
        assert frames([plain]) == [(0x182, b"\x2b\x3c")]
        assert bus.unreadable_lines == 0
        said = iter([heard, plain, None])
        transport, reports = transport_on(SimpleNamespace(recv=lambda _: next(said)))
        assert list(transport.receive()) == [(0x182, b"\x2b\x3c")]
        assert [(f.condition, f.detail) for f in reports.take()] == [(FOREIGN_FRAME, words)]


NO_FRAMES = b"t1811G0 t18 t18132B x t1812ABCDEF F1 t-120 t+120 t1_20 tFFF0 t8000 t123+"
OTHERS = b"T1812 T200000000 T00000181 r8000 r18 r1811223344 R00000181 R0000018113 T0000010031133"
LINES = [*NO_FRAMES.split(), *OTHERS.split(), b"t 120", b"t12 0", b"t1819" + b"00" * 9]


@pytest.mark.parametrize("line", LINES)
def test_a_line_that_is_no_data_frame_is_counted_not_believed(serial_line, line):
    with slcan(PromptSlcanBus, serial_line) as bus:
        heard = play(serial_line, bus, line + b"\rt18222B3C\r")
        assert frames(heard) == [(0x182, b"\x2b\x3c")]
        assert bus.unreadable_lines == 1


def test_a_flood_is_read_in_portions_of_400_frames():
    flood = [can.Message(arbitration_id=0x181, is_extended_id=False) for _ in range(1000)]
    transport, _ = transport_on(SimpleNamespace(recv=lambda _: flood.pop() if flood else None))
    assert [len(list(transport.receive())) for _ in range(4)] == [400, 400, 200, 0]


def test_lines_that_cannot_be_read_are_counted_once():
    bus, reports, now = SimpleNamespace(recv=lambda _: None), FaultReports(1.0), [0.0]
    transport = CanTransport(bus, "CAN test", reports, lambda: now[0])
    told = []
    for now[0], bus.unreadable_lines in ((0.0, 3), (5.0, 3), (10.0, 4), (15.0, 4)):
        list(transport.receive())
        told.append([each.detail for each in reports.take()])
    assert told == [["3 lines cannot be read"], [], ["1 line cannot be read"], []]


class Failing:
    """A bus whose transmissions fail with the errors given, in their order; None: one passes."""

    def __init__(self, *errors):
        self.errors, self.tried = list(errors), 0

    def send(self, message, timeout):
        self.tried += 1
        if (error := self.errors.pop(0)) is not None:
            raise error


FULL = can.CanOperationError("no buffer", errno.ENOBUFS)


@pytest.mark.parametrize(
    ("errors", "off"),
    [([FULL] * 4, False), ([FULL] * 5, True), ([*[FULL] * 4, None, FULL], False)],
)
def test_a_bus_counts_as_off_after_five_frames_in_a_row_that_find_no_room(errors, off):
    bus = Failing(*errors)
    transport, reports = transport_on(bus)
    for _ in errors:
        transport.send(0x080, b"")
    assert [each.condition for each in reports.take()] == [BUS_OFF] * off
    assert transport.up
    assert bus.tried == len(errors)


@pytest.mark.parametrize(
    "error", [can.CanOperationError("gone"), OSError(errno.ENODEV, "gone")], ids=repr
)
def test_an_adapter_that_goes_is_reported_and_sent_nothing_more(error):
    bus = Failing(error)
    transport, reports = transport_on(bus)
    for _ in range(3):
        transport.send(0x080, b"")
    assert [each.condition for each in reports.take()] == [ADAPTER_GONE]
    assert (transport.up, bus.tried) == (False, 1)


@pytest.mark.parametrize(
    ("identifier", "data", "condition"),
    [
        (0x004, b"\0\x10", ERROR_PASSIVE),  # receiving; SocketCAN's error frames
        (0x004, b"\0\x20", ERROR_PASSIVE),  # transmitting
        (0x004, b"\0\x0c", None),  # warning levels only
        (0x004, b"", None),
        (0x040, b"", BUS_OFF),
        (0x080, b"", None),
    ],
)
def test_error_frames_mean_what_they_mean_in_socketcan(identifier, data, condition):
    error = can.Message(
        arbitration_id=identifier, is_error_frame=True, is_extended_id=True, data=data
    )
    said = [error]
    transport, reports = transport_on(SimpleNamespace(recv=lambda _: said.pop() if said else None))
    assert list(transport.receive()) == []
    assert [each.condition for each in reports.take()] == ([condition] if condition else [])


def test_a_frame_of_can_fd_is_foreign():
    said = [can.Message(arbitration_id=0x181, is_extended_id=False, is_fd=True, data=bytes(7))]
    transport, reports = transport_on(SimpleNamespace(recv=lambda _: said.pop() if said else None))
    assert list(transport.receive()) == []
    assert [each.detail for each in reports.take()] == ["181h of CAN FD"]
