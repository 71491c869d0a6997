"""`twin.emulator`.

The emulated LAWICEL adapter with a host that is not ours: python-can's stock slcan bus."""

import time

import can
from can.interfaces.slcan import slcanBus
from hypothesis import given, settings
from hypothesis import strategies as st
from serving import serving

from twin.emulator.can_bus import BusServer, EmulatedBus, SlcanPort
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
    end = time.monotonic() + 60.0
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
        end = time.monotonic() + 60.0
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
