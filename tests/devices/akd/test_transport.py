"""Frames between transport and adapter, on a pseudo-terminal.

A terminal hands over what is written in pieces, some later than the next read where the machine is
busy: all that a program has written is known only once something written after it has come.
"""

import os
import select
from contextlib import contextmanager

import pytest
from can.interfaces.slcan import slcanBus

from twin.devices.akd.bus import CanTransport, PromptSlcanBus, open_bus
from twin.devices.akd.conditions import GARBLED, DriveError
from twin.devices.akd.config import BusConfig
from twin.devices.common import FaultReports


def transport_on(bus):
    reports = FaultReports(1.0)
    return CanTransport(bus, "CAN test", reports, lambda: 0.0), reports


@pytest.fixture
def serial_line():
    pytest.importorskip("pty")
    import tty

    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, slave
    os.close(master)
    os.close(slave)


END = b"#"
"""What no adapter is sent."""


def written(line):
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
        assert written(line).endswith(b"O\r")
        yield bus


def test_the_prompt_bus_writes_all_frames_of_a_period_in_one_piece(serial_line, monkeypatch):
    pieces, write = [], os.write
    monkeypatch.setattr(os, "write", lambda line, data: pieces.append(data) or write(line, data))
    with slcan(PromptSlcanBus, serial_line) as bus:
        transport, reports = transport_on(bus)
        transport.send(0x201, b"\x0f\x00")
        transport.send(0x080, b"")
        assert written(serial_line) == b""
        pieces.clear()
        transport.send_queued()
        assert pieces == [b"t20120F00\rt0800\r"]
        assert written(serial_line) == pieces[0]
        bus.unreadable_lines = 3
        assert list(transport.receive()) == []
        assert [(f.condition, f.detail) for f in reports.take()] == [
            (GARBLED, "3 lines cannot be read")
        ]


def test_a_second_opener_of_an_adapter_is_refused_before_it_sends_a_byte(serial_line):
    with slcan(PromptSlcanBus, serial_line):
        with pytest.raises(DriveError, match="is used by another program"):
            open_bus(slcan_on(serial_line))
        assert written(serial_line) == b""
    assert written(serial_line) == b"C\r"
    open_bus(slcan_on(serial_line)).shutdown()


@pytest.mark.parametrize(("platform", "kind"), [("linux", PromptSlcanBus), ("win32", slcanBus)])
def test_slcan_is_the_library_s_own_where_ports_have_no_descriptor(
    monkeypatch, serial_line, platform, kind
):
    monkeypatch.setattr("twin.devices.akd.bus.sys.platform", platform)
    with open_bus(slcan_on(serial_line)) as bus:
        assert type(bus) is kind
        assert b"S8\r" in written(serial_line)


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
        assert written(serial_line) == b"t0800\r" * 5
