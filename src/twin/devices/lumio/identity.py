"""Which panel a raw HID device belongs to, as Linux describes it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from twin.devices.lumio.hid import Hid0006, Hid0007

VENDOR = 0x202E
PRODUCTS = {0x0006: Hid0006.name, 0x0007: Hid0007.name}
"""Protocols of the products whose reports are known."""
CLASS = Path("/sys/class/hidraw")


class Identity(NamedTuple):
    """A USB device: numbers, the name it gives itself, and the protocol if it is a known panel."""

    vendor: int
    product: int
    name: str
    protocol: str


def identity(port: str, root: Path = CLASS) -> Identity | None:
    """What a ``/dev/hidraw*`` device is; None if that cannot be found out.

    Args:
        port: Path of the device.
        root: Where the kernel describes raw HID devices.
    """
    try:
        text = (root / Path(port).name / "device" / "uevent").read_text(encoding="utf-8")
        entries = dict(line.split("=", 1) for line in text.splitlines() if "=" in line)
        _, vendor, product = (int(part, 16) for part in entries["HID_ID"].split(":"))
    except (OSError, KeyError, ValueError):
        return None
    protocol = PRODUCTS.get(product, "") if vendor == VENDOR else ""
    return Identity(vendor, product, entries.get("HID_NAME", ""), protocol)


def panels(root: Path = CLASS) -> dict[str, Identity]:
    """The Lumio panels plugged in, by the path of their raw HID device."""
    found = {}
    for device in sorted(root.glob("hidraw*")):
        port = f"/dev/{device.name}"
        known = identity(port, root)
        if known is not None and known.vendor == VENDOR:
            found[port] = known
    return found
