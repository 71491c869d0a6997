"""The USB devices of a Lumio panel, as Linux describes them: which node is the touch screen."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from twin.devices.lumio.hid_descriptor import DescriptorError, parse
from twin.devices.lumio.hid_report import ReportDescriptor
from twin.devices.lumio.hid_touch import TouchLayout, application
from twin.devices.lumio.protocols import Hid0006Decoder, Hid0007Decoder

VENDOR = 0x202E
PRODUCTS = {0x0006: Hid0006Decoder.name, 0x0007: Hid0007Decoder.name}
"""Protocols of the products whose reports are known."""
HIDRAW_CLASS = Path("/sys/class/hidraw")
"""Where Linux describes raw HID devices; anyone may read it."""
UDEV_RULES = Path(__file__).with_name("70-ballplate-touch.rules")
"""Rules that let the user at the computer read a panel, and keep it from moving the pointer."""


class UsbIdentity(NamedTuple):
    """A USB device: numbers, the name it gives itself, and the protocol if it is a known panel."""

    vendor: int
    product: int
    name: str
    protocol: str

    @property
    def text(self) -> str:
        """Its numbers and its name."""
        return f"{self.vendor:04x}:{self.product:04x} {self.name}".rstrip()


class Interface(NamedTuple):
    """One interface of a panel. A panel may have several: screen, mouse, keyboard, ...

    Attributes:
        port: Path of its raw HID device.
        identity: Of the panel.
        descriptor: What it says of its reports; None if that cannot be read.
    """

    port: str
    identity: UsbIdentity
    descriptor: ReportDescriptor | None

    @property
    def layout(self) -> TouchLayout | None:
        """Of its touch reports; None if it is not the touch screen."""
        return TouchLayout.of(self.descriptor) if self.descriptor is not None else None

    @property
    def what(self) -> str:
        """What it is, in words."""
        return described(self.descriptor)


def described(descriptor: ReportDescriptor | None) -> str:
    """What an interface is, in words, by its report descriptor."""
    if descriptor is None:
        return "without a readable report descriptor"
    return ", ".join(map(application, descriptor.applications)) or "without any use"


def identify(port: str, root: Path = HIDRAW_CLASS) -> UsbIdentity | None:
    """What a ``/dev/hidraw*`` device is; None if that cannot be found out.

    Args:
        port: Path of the device, or of a link to it.
        root: Where the kernel describes raw HID devices.
    """
    try:
        text = (_device(port, root) / "uevent").read_text(encoding="utf-8")
        entries = dict(line.split("=", 1) for line in text.splitlines() if "=" in line)
        _, vendor, product = (int(part, 16) for part in entries["HID_ID"].split(":"))
    except (OSError, KeyError, ValueError):
        return None
    protocol = PRODUCTS.get(product, "") if vendor == VENDOR else ""
    return UsbIdentity(vendor, product, entries.get("HID_NAME", ""), protocol)


def panels(root: Path = HIDRAW_CLASS) -> list[Interface]:
    """Every interface of the Lumio panels plugged in.

    Args:
        root: Where the kernel describes raw HID devices.
    """
    found = []
    for device in sorted(root.glob("hidraw*"), key=lambda path: (len(path.name), path.name)):
        port = f"/dev/{device.name}"
        known = identify(port, root)
        if known is not None and known.vendor == VENDOR:
            found.append(Interface(port, known, _descriptor(port, root)))
    return found


def touch_screens(root: Path = HIDRAW_CLASS) -> list[Interface]:
    """Of these, the ones that report touches."""
    return [each for each in panels(root) if each.layout is not None]


def _descriptor(port: str, root: Path) -> ReportDescriptor | None:
    try:
        return parse((_device(port, root) / "report_descriptor").read_bytes())
    except (OSError, DescriptorError):
        return None


def _device(port: str, root: Path) -> Path:
    return root / Path(port).resolve().name / "device"
