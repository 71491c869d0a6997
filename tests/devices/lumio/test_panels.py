"""`twin.devices.lumio.config`.

The USB interfaces of a panel as Linux describes them, the rules that give access, the ports."""

import re
import sys

import pytest

from twin.devices.lumio.config import PORT_CLASSES, UDEV_RULES, ScreenError, touch_screens

NAME = "LUMIO Inc LUMIO CrystalTouch ver 02.03.24.00."
PANEL = f"DRIVER=hid-multitouch\nHID_ID=0003:0000202E:00000006\nHID_NAME={NAME}\nHID_PHYS=x\n"
SETTING = re.compile(r'^(\w+(?:\{\w+\})?)(==|!=|=|\+=)"([^"]*)"$')


@pytest.fixture
def root(tmp_path, descriptors):
    """A panel of four interfaces beside another maker's mouse and a device that says nothing."""
    keyboard = descriptors["mouse"].replace(b"\x09\x02", b"\x09\x06", 1)
    for number, (text, descriptor) in enumerate(
        (
            (PANEL, descriptors["mouse"]),
            (PANEL, keyboard),
            (PANEL, b"\x26\xff"),
            (PANEL, descriptors["hid-0006"]),
            ("HID_ID=0003:0000046D:0000C077\nHID_NAME=Mouse\n", descriptors["mouse"]),
            ("nothing", b""),
        )
    ):
        folder = tmp_path / f"hidraw{number}" / "device"
        folder.mkdir(parents=True)
        (folder / "uevent").write_text(text)
        (folder / "report_descriptor").write_bytes(descriptor)
    return tmp_path


def test_of_all_devices_and_interfaces_of_a_panel_the_touch_screen_is_found(root):
    assert touch_screens(root) == ["/dev/hidraw3"]


def rules():
    text = UDEV_RULES.read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    return [[SETTING.match(part.strip()).groups() for part in line.split(",")] for line in lines]


def test_the_udev_rules_are_for_panels_only_and_come_before_systemd_gives_access():
    assert int(UDEV_RULES.name.partition("-")[0]) < 73
    assert len(rules()) == 2
    for rule in rules():
        assert ("ATTRS{idVendor}", "==", "202e") in rule


def test_one_rule_gives_access_to_raw_devices_and_one_keeps_the_ball_off_the_desktop():
    access, desktop = rules()
    assert {("SUBSYSTEM", "==", "hidraw"), ("TAG", "+=", "uaccess")} <= set(access)
    assert {("SUBSYSTEM", "==", "input"), ("ENV{LIBINPUT_IGNORE_DEVICE}", "=", "1")} <= set(desktop)


@pytest.mark.parametrize("kind", sorted(PORT_CLASSES))
def test_a_port_that_cannot_be_opened_without_posix_is_said_in_one_line(kind, monkeypatch):
    for name in ("fcntl", "termios"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ScreenError, match=r"^touch screen /dev/x: needs Linux or macOS, \w+ is"):
        PORT_CLASSES[kind]("/dev/x", 9600).open()
