import subprocess
import sys

import pytest

from twin.devices.lumio.panels import UsbIdentity, identify, panels
from twin.devices.lumio.transports import TRANSPORTS, ScreenError

NAME = "LUMIO Inc LUMIO CrystalTouch ver 02.03.24.00."


@pytest.fixture
def root(tmp_path):
    """Three raw HID devices as the kernel describes them: a panel, a mouse, one unreadable."""
    for number, text in enumerate(
        (
            f"DRIVER=hid-multitouch\nHID_ID=0003:0000202E:00000006\nHID_NAME={NAME}\nHID_PHYS=x\n",
            "HID_ID=0003:0000046D:0000C077\nHID_NAME=Mouse\n",
            "nothing",
        )
    ):
        folder = tmp_path / f"hidraw{number}" / "device"
        folder.mkdir(parents=True)
        (folder / "uevent").write_text(text)
    return tmp_path


def test_a_panel_is_known_by_its_numbers(root):
    assert identify("/dev/hidraw0", root) == UsbIdentity(0x202E, 0x0006, NAME, "hid-0006")


def test_another_makers_device_has_no_protocol(root):
    assert identify("/dev/hidraw1", root).protocol == ""


@pytest.mark.parametrize("port", ["/dev/hidraw2", "/dev/hidraw7"])
def test_a_device_that_is_not_described_is_none(root, port):
    assert identify(port, root) is None


def test_of_all_devices_only_panels_are_found(root):
    assert [each.port for each in panels(root)] == ["/dev/hidraw0"]


def test_the_package_is_imported_where_there_are_no_posix_modules():
    hidden = "import sys; sys.modules.update(dict.fromkeys(('fcntl', 'termios', 'pty', 'tty')))"
    code = f"{hidden}; import twin.devices.lumio.screen"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("kind", sorted(TRANSPORTS))
def test_a_port_that_cannot_be_opened_without_posix_is_said_in_one_line(kind, monkeypatch):
    for name in ("fcntl", "termios"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ScreenError, match=r"^touch screen /dev/x: needs Linux or macOS, \w+ is"):
        TRANSPORTS[kind]("/dev/x", 9600).open()
