"""The LAWICEL protocol against software that is not ours, and lines that are not ours.

The emulated adapter has python-can's stock slcan bus as its host, and the host's own bus is given
the lines that the maker's CAN232 manual (version 3) prints, and any bytes.
"""

import os
import select
import time

import can
import pytest
from can.interfaces.slcan import slcanBus
from hypothesis import given, settings
from hypothesis import strategies as st
from serving import serving

from twin.devices.akd.bus import PromptSlcanBus
from twin.emulator.can_bus import BusServer, EmulatedBus, PseudoTerminal, SlcanPort
from twin.emulator.drive_objects import Frame

FRAMES = st.builds(
    lambda cob_id, data, remote: Frame(cob_id, b"" if remote else data, remote),
    st.integers(0, 0x7FF),
    st.binary(max_size=8),
    st.booleans(),
)
DATA_FRAMES = FRAMES.filter(lambda frame: not frame.remote)


class Recorder(EmulatedBus):
    """A bus that keeps what it is sent, and passes on what is in its queue."""

    def __init__(self):
        super().__init__([])
        self.sent, self.queue = [], []

    def from_host(self, frame):
        self.sent.append(frame)
        return True

    def to_host(self):
        queue, self.queue = self.queue, []
        return queue


def stock(channel):
    return slcanBus(channel, bitrate=1_000_000, sleep_after_open=0.0)


def pump_until(port, done):
    """Let the adapter do what it has been sent: a pseudo-terminal takes a moment."""
    end = time.monotonic() + 5.0
    while not done() and time.monotonic() < end:
        port.wait(0.05)
        port.pump()


def as_frame(message):
    assert not any((message.is_extended_id, message.is_error_frame, message.is_fd))
    return Frame(message.arbitration_id, bytes(message.data), message.is_remote_frame)


@given(st.lists(FRAMES, min_size=1, max_size=8))
@settings(max_examples=40)
def test_what_python_can_writes_the_adapter_reads(frames):
    bus = Recorder()
    with SlcanPort(bus) as port, stock(str(port.path)) as host:
        for frame in frames:
            host.send(
                can.Message(
                    arbitration_id=frame.cob_id,
                    data=frame.data,
                    is_remote_frame=frame.remote,
                    is_extended_id=False,
                )
            )
        pump_until(port, lambda: len(bus.sent) == len(frames))
    assert bus.sent == frames


@given(st.lists(DATA_FRAMES, min_size=1, max_size=8))
@settings(max_examples=40)
def test_what_the_adapter_writes_python_can_reads(frames):
    bus = Recorder()
    with SlcanPort(bus) as port, stock(str(port.path)) as host:
        pump_until(port, lambda: port.adapter.open)
        bus.queue = list(frames)
        port.pump()
        heard = []
        # The stock bus hands out None for every acknowledgement on its way.
        end = time.monotonic() + 10.0
        while len(heard) < len(frames) and time.monotonic() < end:
            message = host.recv(0.01)
            heard += [] if message is None else [as_frame(message)]
    assert heard == frames


def test_python_can_opens_asks_and_closes_the_adapter():
    bus = Recorder()
    with SlcanPort(bus) as port, serving(BusServer(bus, port)), stock(str(port.path)) as host:
        assert host.get_version(10.0) == (10, 13)
        assert host.get_serial_number(10.0) == "EMUL"
        assert port.adapter.open
        assert port.adapter.bitrate == 1_000_000


class Adapter:
    """Our host's bus on a pseudo-terminal on which lines are played."""

    def __init__(self):
        self.terminal = PseudoTerminal("adapter")
        self.terminal.plug()
        self.bus = PromptSlcanBus(str(self.terminal.path), 1_000_000, sleep_after_open=0.0)
        self.commands = self.said()

    def play(self, lines):
        """Every message that the bus makes of some bytes."""
        os.write(self.terminal.handle, lines)
        end = time.monotonic() + 10.0
        while self.bus.serialPortOrig.in_waiting < len(lines):  # it is handed over in pieces
            assert time.monotonic() < end, f"of {lines!r} not all arrived"
            time.sleep(1e-4)
        heard, message = [], self.bus.recv(0)
        while message is not None:
            heard.append(message)
            message = self.bus.recv(0)
        return heard

    def said(self):
        """All that the bus has written since the last call, up to a mark that is written now."""
        os.write(self.bus.serialPortOrig.fileno(), b"#")
        data = b""
        while not data.endswith(b"#"):
            assert select.select([self.terminal.handle], [], [], 10.0)[0], f"only {data!r}"
            data += os.read(self.terminal.handle, 4096)
        return data.removesuffix(b"#")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.bus.shutdown()
        self.terminal.close()


def test_our_host_opens_an_adapter_with_the_commands_of_the_manual():
    with Adapter() as adapter:
        commands = adapter.commands.split(b"\r")
    # Closed before it is set up, then open; more C, O and empty lines do no harm.
    assert commands.index(b"C") < commands.index(b"S8") < commands.index(b"O")
    assert set(commands) <= {b"C", b"S8", b"O", b""}


def test_our_host_transmits_as_the_manual_says():
    with Adapter() as adapter:
        adapter.bus.send(can.Message(arbitration_id=0x100, data=b"\x11\x33", is_extended_id=False))
        adapter.bus.send(can.Message(arbitration_id=0x20, is_extended_id=False))
        adapter.bus.recv(0)
        # The examples of the command t in the manual, and the question for the status flags.
        assert adapter.said() == b"t10021133\rt0200\rF\r"


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        (b"t10021133\r", Frame(0x100, b"\x11\x33")),
        (b"t0200\r", Frame(0x20)),
        (b"t100211334D67\r", Frame(0x100, b"\x11\x33")),
        (b"z\r\rt10021133\r", Frame(0x100, b"\x11\x33")),
        (b"V1013\rt0200\r", Frame(0x20)),
        (b"NA123\rt0200\r", Frame(0x20)),
        (b"F00\rt0200\r", Frame(0x20)),
        (b"\at0200\r", Frame(0x20)),
    ],
    ids=repr,
)
def test_our_host_reads_the_lines_that_the_manual_prints(line, frame):
    with Adapter() as adapter:
        assert [as_frame(each) for each in adapter.play(line)] == [frame]


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
def test_our_host_makes_error_frames_of_the_manual_s_status_bits(flags, identifier):
    with Adapter() as adapter:
        heard = adapter.play(b"F%02X\r" % flags)
        assert [each.arbitration_id for each in heard] == ([identifier] if identifier else [])
        assert all(each.is_error_frame for each in heard)


@given(st.lists(st.binary(max_size=40), max_size=6))
@settings(max_examples=40)
def test_our_host_takes_any_bytes_of_an_adapter(chunks):
    with Adapter() as adapter:
        for message in (each for chunk in chunks for each in adapter.play(chunk)):
            assert len(message.data) <= 8
            assert message.is_error_frame or 0 <= message.arbitration_id <= 0x7FF


EXTENDED_OR_REMOTE = b"T0000010021133 r1002 r1000 R000001002"
"""Lines of the manual."""
NO_FRAMES = b"t1811G0 t18 t18132B x t1812ABCDEF F1 t-120 t+120 t1_20 tFFF0 t8000 t123+"
LINES = [*EXTENDED_OR_REMOTE.split(), *NO_FRAMES.split(), b"t 120", b"t12 0", b"t1819" + b"00" * 9]


@pytest.mark.parametrize("line", LINES)
def test_a_line_that_is_no_data_frame_is_counted_not_believed(line):
    with Adapter() as adapter:
        assert [as_frame(each) for each in adapter.play(line + b"\rt18222B3C\r")] == [
            Frame(0x182, b"\x2b\x3c")
        ]
        assert adapter.bus.unreadable_lines == 1
