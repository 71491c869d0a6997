"""Tests of `twin.emulator`."""

import os
import random
import re
import time
from types import SimpleNamespace

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from serving import serving, servos_on

from twin.devices.akd import conditions as c
from twin.devices.akd.bus import open_bus
from twin.devices.akd.conditions import DriveError
from twin.devices.akd.config import AkdConfig, BusConfig
from twin.devices.akd.servos import AkdServos
from twin.emulator import can_bus
from twin.emulator.can_bus import BusServer, EmulatedBus, SlcanAdapter, SlcanPort, nothing
from twin.emulator.direct_bus import message
from twin.emulator.drive import EmulatedDrive
from twin.emulator.drive_objects import Frame
from twin.emulator.power_stage import Power


def drives():
    return [EmulatedDrive(node) for node in (1, 2)]


@pytest.fixture
def bus():
    return EmulatedBus(drives())


class FailingPort(SlcanPort):
    """A port whose line and firmware can fail."""

    garble = 0.0
    """Share of the bytes towards the computer that are damaged."""
    stalled = False
    """Neither reads nor writes."""
    dice = random.Random(0)

    def wait(self, seconds):
        time.sleep(seconds) if self.stalled else super().wait(seconds)

    def pump(self, passing=nothing):
        self._bus.to_host() if self.stalled else super().pump(passing)

    def write(self, data):
        damaged = (
            self.dice.randrange(256) if self.dice.random() < self.garble else byte for byte in data
        )
        return super().write(bytes(damaged))


@pytest.fixture
def port(bus):
    with FailingPort(bus) as made:
        yield made


@pytest.fixture(autouse=True)
def brief_farewell(monkeypatch):
    """Drives that do not hear any more are not waited for as long as on a rig."""
    monkeypatch.setattr("twin.devices.akd.servos.SHUTDOWN_STEP_LIMIT_S", 0.1)


def config(port, **changes):
    quick = {"sleep_after_open": 0.0}
    settings = {"interface": "slcan", "channel": str(port.path), "options": quick}
    return BusConfig(**{**settings, **changes})


def run(servos, seconds, found=None, until=lambda: False):
    """Exchange in real time; the faults, ended early by a condition or when something is true."""
    seen = []
    end = time.monotonic() + seconds
    while time.monotonic() < end and not until():
        servos.receive()
        servos.send()
        servos.settle(0.002)
        seen += servos.faults()
        if found in [fault.condition for fault in seen]:
            break
    return [fault.condition for fault in seen]


def turn(servos, rate):
    """Start both drives and have them turn at a rate in rad/s, one either way."""
    servos.start()
    servos.enable()
    run(servos, 5.0, until=lambda: servos.enabled)
    assert servos.enabled
    servos.command([[rate, -rate]])
    goal = pytest.approx(rate, rel=1e-3)
    run(servos, 5.0, until=lambda: servos.axes[0].rate == goal)
    assert servos.axes[0].rate == goal


@pytest.mark.parametrize(
    ("sent", "answered"),
    [
        (b"S8\rO\r", b"\r\r"),
        (b"O\r", b"\a"),
        (b"S8\rO\rO\r", b"\r\r\a"),
        (b"S8\rO\rS6\r", b"\r\r\a"),
        (b"C\r", b"\a"),
        (b"S8\rO\rC\r", b"\r\r\r"),
        (b"S8\rO\rt0800\r", b"\r\rz\r"),
        (b"t0800\r", b"\a"),
        (b"S8\rO\rt08\r", b"\r\r\a"),
        (b"S8\rO\rt0802FF\r", b"\r\r\a"),
        (b"S8\rO\rF\r", b"\r\rF00\r"),
        (b"V\rN\r\r", b"V1013\rNEMUL\r\r"),
        (b"Q\r", b"\a"),
    ],
)
def test_the_adapter_answers_as_lawicel_s_protocol_says(bus, sent, answered):
    assert SlcanAdapter(bus).feed(sent) == answered


def test_a_frame_of_the_bus_is_written_in_hexadecimal(bus):
    adapter = SlcanAdapter(bus)
    adapter.feed(b"S8\rO\r")
    bus.step(0.001)
    bus.to_host()
    adapter.feed(b"t60184000100000000000\r")
    assert adapter.heard() == b"t58184300100092010200\r"


def test_an_adapter_at_another_bit_rate_hears_nothing_and_then_refuses(bus):
    adapter = SlcanAdapter(bus)
    adapter.feed(b"S6\rO\r")
    assert adapter.feed(b"t0800\r" * 5) == b"z\r" * 3 + b"\a" * 2
    assert adapter.feed(b"F\r") == b"FA4\r"
    bus.step(0.01)
    assert adapter.heard() == b""


@given(st.binary(max_size=80))
@settings(max_examples=80)
def test_the_adapter_takes_any_bytes_and_answers_every_line(data):
    adapter = SlcanAdapter(EmulatedBus(drives()))
    answers = adapter.feed(b"S8\rO\r" + data)
    assert re.fullmatch(rb"(z?\r|\a|F[0-9A-F]{2}\r|V1013\r|NEMUL\r)*", answers)
    assert len(re.findall(rb"[\r\a]", answers)) == 2 + data.count(b"\r")
    assert re.fullmatch(rb"(t[0-7][0-9A-F]{2}[0-8]([0-9A-F]{2})*\r)*", adapter.heard())


class VirtualPort:
    """The emulated bus on a channel of python-can's ``virtual`` interface."""

    def __init__(self, bus):
        self.bus = bus
        self.channel = can.Bus(interface="virtual", channel="emulated")
        self.first = None

    def wait(self, seconds):
        self.first = self.first or self.channel.recv(seconds)

    def pump(self, passing=None):
        heard, self.first = self.first or self.channel.recv(0), None
        while heard is not None:
            data, remote = bytes(heard.data), heard.is_remote_frame
            self.bus.from_host(Frame(heard.arbitration_id, data, remote))
            heard = self.channel.recv(0)
        for frame in self.bus.to_host():
            self.channel.send(message(frame.cob_id, frame.data))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.channel.shutdown()


@pytest.mark.real_time
@pytest.mark.parametrize("kind", [SlcanPort, VirtualPort])
def test_the_servos_run_over_a_real_pty_and_on_any_interface_of_python_can(bus, kind):
    virtual = BusConfig(interface="virtual", channel="emulated")
    with (
        kind(bus) as port,
        serving(BusServer(bus, port)) as server,
        servos_on(virtual if kind is VirtualPort else config(port)) as servos,
    ):
        turn(servos, 1.0)
        servos.stop()
        with server.lock:
            assert [drive.power.faults for drive in bus.drives] == [[], []]
            assert [drive.state for drive in bus.drives] == [Power.SWITCH_ON_DISABLED] * 2


@pytest.mark.long
@pytest.mark.real_time
def test_answers_of_an_emulator_that_paused_are_late(bus, port):
    with serving(BusServer(bus, port)) as server, servos_on(config(port)) as servos:
        turn(servos, 5.0)
        seen = []
        for _ in range(10):
            with server.lock:
                seen += run(servos, 0.03)
            seen += run(servos, 0.1, c.PDO_LATE)
        assert c.PDO_LATE in seen


def test_syncs_that_waited_for_an_emulator_that_paused_each_have_their_own_time(monkeypatch):
    clock, steps, at = SimpleNamespace(now=100.0), [], []

    def pump(told):
        for share in np.arange(1, 16) / 15:
            told(share)
            at.append(sum(steps))
        server.stop()

    monkeypatch.setattr(can_bus, "time", SimpleNamespace(monotonic=lambda: clock.now))
    waits = SimpleNamespace(wait=lambda _: setattr(clock, "now", clock.now + 0.03), pump=pump)
    server = BusServer(SimpleNamespace(step=steps.append), waits, step=0.0005)
    server.run()
    assert at == pytest.approx(0.002 * np.arange(1, 16), abs=0.0005 + 1e-9)


def test_of_syncs_that_have_waited_it_is_told_which_share_of_the_time_each_is(bus, port):
    told = []
    handle = os.open(str(port.path), os.O_RDWR | os.O_NOCTTY)
    try:
        for number in (1, 4):
            os.write(handle, b"t0800\r" * number)
            port.wait(1.0)
            port.pump(told.append)
    finally:
        os.close(handle)
    assert told == [1.0, 0.25, 0.5, 0.75, 1.0]


@pytest.mark.real_time
@pytest.mark.parametrize(
    ("cause", "condition"),
    [
        (lambda port, bus: setattr(bus.faults, "bus_off", True), c.BUS_OFF),
        (lambda port, bus: setattr(bus.faults, "error_passive", True), c.ERROR_PASSIVE),
        (lambda port, bus: port.unplug(), c.ADAPTER_GONE),
        (lambda port, bus: setattr(port, "garble", 0.02), c.GARBLED),
        (lambda port, bus: setattr(port, "stalled", True), c.PDO_STALE),
    ],
    ids=["bus off", "error passive", "unplugged", "garbled", "stalled"],
)
def test_trouble_with_the_adapter_is_noticed(bus, port, cause, condition):
    with serving(BusServer(bus, port)) as server, servos_on(config(port)) as servos:
        servos.start()
        servos.enable()
        run(servos, 0.1)
        with server.lock:
            cause(port, bus)
        seen = run(servos, 2.0, condition)
        assert condition in seen, [each.name for each in seen]


@pytest.mark.long
@pytest.mark.real_time
def test_another_bit_rate_is_named_as_the_likely_cause(port, bus):
    bus.bitrate = 500_000
    with serving(BusServer(bus, port)), servos_on(config(port)) as servos:
        with pytest.raises(DriveError) as caught:
            servos.start()
        assert caught.value.fault.condition == c.BIT_RATE


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"interface": "sockecan"}, "did you mean 'socketcan'?"),
        ({"interface": "slcan", "channel": "/dev/ttyNONE9"}, "no channel"),
        ({"interface": "slcan", "bitrate": 123}, "bitrate"),
    ],
    ids=str,
)
def test_a_bus_that_cannot_be_opened_is_one_clear_line(port, changes, words):
    with pytest.raises(DriveError) as caught:
        open_bus(config(port, **changes))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_port_that_is_no_serial_port_is_said_so(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(DriveError, match="is no serial port"):
        open_bus(BusConfig(interface="slcan", channel=str(tmp_path / "file")))


@pytest.mark.real_time
def test_nothing_is_left_open_when_no_drive_answers(port):
    opened = []

    def opener(bus):
        opened.append(open_bus(bus))
        return opened[0]

    with pytest.raises(DriveError), serving(BusServer(EmulatedBus([]), port)):
        AkdServos(AkdConfig(bus=config(port)), opener=opener).start()
    assert not opened[0].serialPortOrig.is_open
