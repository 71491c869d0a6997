import pytest

from twin.devices.lumio.identity import Identity, identity, panels

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
    assert identity("/dev/hidraw0", root) == Identity(0x202E, 0x0006, NAME, "hid-0006")


def test_another_makers_device_has_no_protocol(root):
    assert identity("/dev/hidraw1", root).protocol == ""


@pytest.mark.parametrize("port", ["/dev/hidraw2", "/dev/hidraw7"])
def test_a_device_that_is_not_described_is_none(root, port):
    assert identity(port, root) is None


def test_of_all_devices_only_panels_are_found(root):
    assert list(panels(root)) == ["/dev/hidraw0"]
