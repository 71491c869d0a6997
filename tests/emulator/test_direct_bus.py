"""Tests of `twin.emulator.direct_bus`: a bus that a host steps, without real time."""

import can
import pytest
from can.exceptions import CanOperationError

from twin.emulator.can_bus import EmulatedBus
from twin.emulator.direct_bus import DirectBus
from twin.emulator.drive_objects import Frame


class Beacon:
    """A participant that sends its time in us every so many seconds, and answers what it hears."""

    node, rate = 7, 0.0

    def __init__(self, every):
        self.every, self.time, self.sent = every, 0.0, 0
        self.steps, self.heard = [], []

    def step(self, dt):
        self.time += dt
        self.steps.append(dt)
        while self.every * (self.sent + 1) <= self.time + 1e-12:
            self.sent += 1
            yield Frame(0x187, round(1e6 * self.time).to_bytes(4, "little"))

    def receive(self, frame):
        self.heard.append(frame)
        return [Frame(0x587, frame.data[::-1], frame.remote)] if frame.data else []


@pytest.fixture
def beacon():
    return Beacon(0.010)


@pytest.fixture
def host(beacon):
    with DirectBus(EmulatedBus([beacon])) as bus:
        yield bus


def test_sleep_lets_exactly_its_time_pass_in_steps_that_are_short(host, beacon):
    host.sleep(0.0123)
    assert host.now() == pytest.approx(0.0123, abs=1e-8)
    assert max(beacon.steps) <= 0.0005
    assert len(beacon.steps) == 25


def test_a_frame_is_received_when_it_is_sent_and_no_later(host):
    found = host.recv(1.0)
    assert found.arbitration_id == 0x187
    assert int.from_bytes(found.data, "little") == 10000
    assert host.now() == pytest.approx(0.010, abs=5e-4)


def test_a_wait_without_a_frame_ends_after_its_time_on_the_bus(host):
    assert host.recv(0.004) is None
    assert host.now() == pytest.approx(0.004, abs=1e-8)
    assert host.recv(None) is None
    assert host.recv(0) is None
    assert host.now() == pytest.approx(0.004, abs=1e-8)


def test_frames_of_a_sleep_are_received_in_order_and_each_once(host):
    host.sleep(0.035)
    stamps = []
    while (found := host.recv(0)) is not None:
        stamps.append(int.from_bytes(found.data, "little"))
    assert stamps == [10000, 20000, 30000]


@pytest.mark.parametrize("remote", [False, True])
def test_what_the_host_sends_is_heard_at_once_and_answered(host, beacon, remote):
    data = b"" if remote else b"\1\2\3"
    host.send(can.Message(arbitration_id=0x607, is_extended_id=False, is_remote_frame=remote,
                          data=None if remote else data))  # fmt: skip
    assert beacon.heard == [Frame(0x607, data, remote)]
    answer = host.recv(0)
    assert (answer is None) == remote
    assert remote or bytes(answer.data) == b"\3\2\1"
    assert host.now() == 0.0


def test_an_unplugged_adapter_neither_sends_nor_receives_until_it_is_back(host, beacon):
    host.plugged = False
    for act in (host.recv, lambda: host.send(can.Message(arbitration_id=1, data=b"\1"))):
        with pytest.raises(CanOperationError, match="unplugged"):
            act()
    assert beacon.heard == []
    host.plugged = True
    assert host.recv(0.02) is not None


@pytest.mark.parametrize(("fault", "identifier"), [("bus_off", 0x040), ("error_passive", 0x004)])
def test_a_fault_of_the_adapter_is_reported_once_each_time_it_begins(host, fault, identifier):
    for _ in range(2):
        setattr(host._bus.faults, fault, True)
        report = host.recv(0.001)
        assert report.is_error_frame
        assert report.arbitration_id == identifier
        assert host.recv(0.001) is None
        setattr(host._bus.faults, fault, False)
        assert host.recv(0.001) is None
