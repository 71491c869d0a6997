"""The ports a touch screen is plugged into: serial line, raw HID device, input event device.

Opening one needs a POSIX system, raw HID and input event devices Linux; importing does not.
"""

from __future__ import annotations

import errno
import os
import select
from abc import ABC, abstractmethod
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from twin.devices.lumio.protocols import Hid0006Decoder, Hid0007Decoder
from twin.errors import TwinError

if TYPE_CHECKING:
    import serial

VENDOR = 0x202E
PRODUCTS = {0x0006: Hid0006Decoder.name, 0x0007: Hid0007Decoder.name}
"""Protocols of the products whose reports are known."""
HIDRAW_CLASS = Path("/sys/class/hidraw")
"""Where Linux describes raw HID devices."""


class ScreenError(TwinError, OSError):
    """A touch screen's port cannot be opened or has gone."""


_REASONS = {
    errno.ENOENT: "no such device; is it plugged in?",
    errno.ENODEV: "no such device; is it plugged in?",
    errno.ENXIO: "no such device; is it plugged in?",
    errno.EAGAIN: "busy; another program has it open",
    errno.EBUSY: "busy; another program has it open",
    errno.EIO: "hung up; was it unplugged?",
    errno.ENOTTY: "not a serial port",
}


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

    @abstractmethod
    def close(self) -> None:
        """Close the port; never raises."""

    @abstractmethod
    def _open(self) -> int:
        """Open the port exclusively and return its file descriptor."""

    def _ready(self, timeout: float) -> bool:
        return bool(select.select([self._handle], [], [], timeout)[0])

    def _in_words(self, error: OSError | ValueError) -> ScreenError:
        """The error in one line."""
        number = error.errno if isinstance(error, OSError) and error.errno else errno.EINVAL
        if number in {errno.EACCES, errno.EPERM}:
            reason = f"permission denied; {self.PERMISSION}"
        else:
            reason = _REASONS.get(number, os.strerror(number))
        return ScreenError(f"touch screen {self.port}: {reason}")


class SerialPort(Transport):
    """A serial line, 8N1."""

    PERMISSION = "add the user to the group that owns it (dialout)"

    def __init__(self, port: str, baud: int) -> None:
        super().__init__(port, baud)
        self._line: serial.Serial | None = None

    def _open(self) -> int:
        import termios  # noqa: F401, PLC0415  closing needs it

        import serial  # noqa: PLC0415  on POSIX it imports fcntl and termios

        try:
            self._line = serial.Serial(self.port, self.baud, timeout=0, exclusive=True)
        except serial.SerialException as error:
            # Without a number: the device does not know the settings of a serial line.
            raise OSError(error.errno or errno.ENOTTY, str(error)) from error
        return int(self._line.fileno())

    def close(self) -> None:
        """Close the line."""
        if self._line is not None:
            import termios  # noqa: PLC0415  POSIX only

            with suppress(OSError, termios.error):
                self._line.close()
            self._line = None


class DeviceFile(Transport):
    """A device file that is read as it is."""

    def _open(self) -> int:
        import fcntl  # noqa: PLC0415  POSIX only

        handle = os.open(self.port, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(handle)
            raise
        return handle

    def close(self) -> None:
        """Close the device."""
        if self._handle >= 0:
            with suppress(OSError):
                os.close(self._handle)
            self._handle = -1


class HidrawDevice(DeviceFile):
    """A raw HID device: one report per read."""

    PERMISSION = "a udev rule must give /dev/hidraw* of vendor 202e to the user"


class EvdevDevice(DeviceFile):
    """An input event device."""

    PERMISSION = "add the user to the group that owns it (input)"


TRANSPORTS: dict[str, type[Transport]] = {
    "serial": SerialPort,
    "hidraw": HidrawDevice,
    "evdev": EvdevDevice,
}
"""Every kind of port by the name a rig file gives it."""


class UsbIdentity(NamedTuple):
    """A USB device: numbers, the name it gives itself, and the protocol if it is a known panel."""

    vendor: int
    product: int
    name: str
    protocol: str


def identify(port: str, root: Path = HIDRAW_CLASS) -> UsbIdentity | None:
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
    return UsbIdentity(vendor, product, entries.get("HID_NAME", ""), protocol)


def panels(root: Path = HIDRAW_CLASS) -> dict[str, UsbIdentity]:
    """The Lumio panels plugged in, by the path of their raw HID device."""
    found = {}
    for device in sorted(root.glob("hidraw*")):
        port = f"/dev/{device.name}"
        known = identify(port, root)
        if known is not None and known.vendor == VENDOR:
            found[port] = known
    return found
