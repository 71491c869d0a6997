"""The ports of a touch screen: serial line or raw HID device, and where Linux has it.

Opening one needs a POSIX system, a raw HID device Linux; importing does not.
"""

from __future__ import annotations

import errno
import os
import select
from abc import ABC, abstractmethod
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import NamedTuple

from twin.devices.common import claim, in_words
from twin.devices.lumio.protocols import (
    Decoder,
    DescriptorError,
    HidDecoder,
    ReportDescriptor,
    TouchLayout,
    parse,
)
from twin.errors import TwinError

VENDOR = 0x202E
PRODUCTS = {0x0006: "hid-0006", 0x0007: "hid-0007"}
"""Protocols of the products whose report descriptors are in ``panels.toml``."""
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
        return self.descriptor.what if self.descriptor else "without a readable report descriptor"


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
            found.append(Interface(port, known, _readable(port, root)))
    return found


def touch_screens(root: Path = HIDRAW_CLASS) -> list[Interface]:
    """Of these, the ones that report touches."""
    return [each for each in panels(root) if each.layout is not None]


def _readable(port: str, root: Path) -> ReportDescriptor | None:
    with suppress(OSError, DescriptorError):
        return _descriptor(port, root)
    return None


def _descriptor(port: str, root: Path) -> ReportDescriptor:
    return parse((_device(port, root) / "report_descriptor").read_bytes())


def _device(port: str, root: Path) -> Path:
    return root / Path(port).resolve().name / "device"


class ScreenError(TwinError, OSError):
    """A touch screen's port cannot be opened or has gone."""


class Transport(ABC):
    """A port to read bytes from, one opener at a time.

    Args:
        port: Path of the device.
        baud: Bits per second, for a serial line.
    """

    MOST = 4096
    PERMISSION = ""
    """What gives a user the right to open it."""

    def __init__(self, port: str, baud: int) -> None:
        self.port = port
        self.baud = baud
        self._handle = -1
        self._opened = ExitStack()

    def open(self) -> None:
        """Open the port and drop what has waited in it.

        Raises:
            ScreenError: Absent, not permitted, busy or of another kind; or no POSIX system.
        """
        try:
            self._handle = self._open()
            # What waits is older than now, and its arrival time is not known.
            while self._ready(0.0) and len(os.read(self._handle, self.MOST)) == self.MOST:
                pass
        except ImportError as error:
            raise ScreenError(
                f"touch screen {self.port}: needs Linux or macOS, {error.name} is missing here"
            ) from error
        except (OSError, ValueError) as error:
            self.close()
            raise self._in_words(error) from error

    def read(self, timeout: float) -> bytes:
        """What has arrived, or nothing after a timeout in s.

        Raises:
            ScreenError: The port has gone.
        """
        try:
            if not self._ready(timeout):
                return b""
            data = os.read(self._handle, self.MOST)
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise self._in_words(error) from error
        if not data:
            raise self._in_words(OSError(errno.EIO, "end of file"))
        return data

    def decoder(self) -> Decoder | None:
        """The decoder that the open port itself asks for; None if it does not say.

        Raises:
            ScreenError: It says that it is no touch screen.
        """
        return None

    def close(self) -> None:
        """Close the port; never raises."""
        self._handle = -1
        with suppress(Exception):  # of whatever kind: the port may have gone
            self._opened.close()

    @abstractmethod
    def _open(self) -> int:
        """Open the port exclusively until ``_opened`` is closed; return its file descriptor."""

    def _ready(self, timeout: float) -> bool:
        return bool(select.select([self._handle], [], [], timeout)[0])

    def _in_words(self, error: OSError | ValueError) -> ScreenError:
        """The error in one line."""
        number = error.errno if isinstance(error, OSError) and error.errno else errno.EINVAL
        reason = in_words("screen", number, permission=self.PERMISSION) or os.strerror(number)
        return ScreenError(f"touch screen {self.port}: {reason}")


class SerialPort(Transport):
    """A serial line, 8N1."""

    PERMISSION = "add the user to the group that owns it (dialout)"

    def _open(self) -> int:
        import termios  # noqa: F401, PLC0415  a POSIX system is needed

        import serial  # noqa: PLC0415  on POSIX it imports fcntl and termios

        try:
            line = serial.Serial(self.port, self.baud, timeout=0, exclusive=True)
        except serial.SerialException as error:
            # Without a number: the device does not know the settings of a serial line.
            raise OSError(error.errno or errno.ENOTTY, str(error)) from error
        self._opened.callback(line.close)
        return int(line.fileno())


class HidrawDevice(Transport):
    """A raw HID device: one report per read, laid out as the device itself says."""

    PERMISSION = "a udev rule must give it to the user; `ballplate doctor --udev` prints one"

    def decoder(self) -> Decoder | None:
        """A decoder by the report descriptor; None for a port that has none, as on a virtual rig.

        Raises:
            ScreenError: The device is not a touch screen.
        """
        try:
            descriptor = _descriptor(self.port, HIDRAW_CLASS)
        except OSError:
            return None
        except DescriptorError as error:
            reason = f"its report descriptor cannot be read: {error}"
            raise ScreenError(f"touch screen {self.port}: {reason}") from error
        layout = TouchLayout.of(descriptor)
        if layout is None:
            others = ", ".join(each.port for each in touch_screens())
            hint = f"; the touch screen is {others}" if others else ""
            what = f"no touch screen but {descriptor.what}{hint}"
            raise ScreenError(f"touch screen {self.port}: {what}")
        return HidDecoder(layout)

    def _open(self) -> int:
        handle = claim(self.port, os.O_RDONLY)
        self._opened.callback(os.close, handle)
        return handle


TRANSPORTS: dict[str, type[Transport]] = {
    "serial": SerialPort,
    "hidraw": HidrawDevice,
}
"""Every kind of port by the name a rig file gives it."""
