"""`twin.devices.lumio.screen`: The screen over a pty: real bytes, a real thread, real time."""

import errno
import math
import os
import time

import numpy as np
import pytest
from served_screen import EmulatedScreen

from twin.base.jobs import wait_until
from twin.devices.lumio.config import LumioConfig, ScreenError
from twin.devices.lumio.screen import LumioScreen, TouchState
from twin.emulator.screen import Protocol, ScreenLine

pytestmark = pytest.mark.real_time


def emulate(ball, **settings):
    # a tenth of a screen's dead time: nothing here is about it, and all would wait for it
    return EmulatedScreen(ScreenLine(ball, **{"dead_time": 0.004, **settings}))


PLACE = (0.2, 0.05)
SERIAL = (Protocol.MICROTOUCH, Protocol.ELO)


def config(emulated, **options):
    transport = "serial" if emulated.protocol in SERIAL else "hidraw"
    return LumioConfig(port=str(emulated.path), transport=transport, **options)


def sees(screen):
    """Whether a screen feels a ball soon."""
    return wait_until(lambda: bool(screen.read().touched[0]), 60.0)


@pytest.mark.parametrize(
    ("protocol", "name"),
    [*((each, each.value) for each in Protocol), *((each, "auto") for each in SERIAL)],
)
def test_a_ball_is_seen_where_it_lies_in_every_protocol_named_or_detected(protocol, name):
    with (
        emulate(lambda: [PLACE], protocol=protocol) as emulated,
        LumioScreen(config(emulated, protocol=name)) as screen,
    ):
        assert sees(screen)
        assert wait_until(lambda: 0 <= screen.read().age[0] < 0.06, 60.0)
        touch = screen.read()
        assert screen.protocol == protocol.partition("-")[0]
    assert np.allclose(touch.position, [PLACE], atol=3e-4)
    assert [part.shape for part in touch] == [(1, 2), (1,), (1,)]


def test_before_any_touch_there_is_no_ball():
    with emulate(list) as emulated, LumioScreen(config(emulated)) as screen:
        touch = screen.read()
        assert (touch.age[0], touch.touched[0]) == (math.inf, False)
        assert screen.state == TouchState.LOST
        assert screen.faults() == ()


def test_a_screen_unplugged_is_told_and_after_plugging_in_works_when_started_anew():
    with (
        emulate(lambda: [PLACE]) as emulated,
        LumioScreen(config(emulated)) as screen,
    ):
        assert sees(screen)
        emulated.unplug()
        assert wait_until(
            lambda: "touch screen gone" in [each.condition.name for each in screen.faults()], 60.0
        )
        assert not screen.connected
        emulated.plug()
        time.sleep(0.1)
        assert not screen.connected
        screen.stop()
        screen.stop()
        screen.start()
        assert sees(screen)


def test_a_file_that_is_no_serial_port_is_said_in_one_line(tmp_path):
    path = tmp_path / "file"
    path.touch()
    with pytest.raises(ScreenError, match="not a serial port"):
        LumioScreen(LumioConfig(port=str(path))).start()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"port": "nowhere/x", "transport": "serial"}, "no such device"),
        ({"port": "nowhere/x", "transport": "hidraw"}, "no such device"),
        ({"port": "a\0b"}, ""),
        ({"port": "/dev/null", "baud": 10**9}, ""),
    ],
)
def test_a_port_that_cannot_be_is_said_in_one_line(options, words):
    with pytest.raises(ScreenError, match=f"^touch screen .*{words}") as caught:
        LumioScreen(LumioConfig(**options)).start()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("protocol", [Protocol.MICROTOUCH, Protocol.HID_0006])
def test_a_port_that_another_program_has_open_is_busy(protocol):
    with (
        emulate(list, protocol=protocol) as emulated,
        LumioScreen(config(emulated)),
        pytest.raises(ScreenError, match="busy"),
    ):
        LumioScreen(config(emulated)).start()


def test_a_port_without_permission_is_said_with_what_to_do(monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(ScreenError, match=r"permission denied; a udev rule"):
        LumioScreen(LumioConfig(port="/dev/hidraw0", transport="hidraw")).start()
    with pytest.raises(ScreenError, match=r"permission denied; add the user"):
        LumioScreen(LumioConfig(port="/dev/ttyUSB0")).start()
