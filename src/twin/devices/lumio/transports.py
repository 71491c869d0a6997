"""The ports a touch screen is plugged into: serial line, raw HID device, input event device."""

from __future__ import annotations

import errno
import fcntl
import os
import select
import termios
from abc import ABC, abstractmethod
from contextlib import suppress

import serial

from twin.errors import TwinError


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
        baud: Bits a second, for a serial line.
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
            ScreenError: Absent, not permitted, busy or of another kind.
        """
        try:
            self._handle = self._open()
            # What waits is older than now, and its arrival time is not known.
            while self._ready(0.0) and len(os.read(self._handle, self.MOST)) == self.MOST:
                pass
        except (OSError, ValueError) as error:
            self.close()
            raise self._told(error) from error

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
            raise self._told(error) from error
        if not data:
            raise self._told(OSError(errno.EIO, "end of file"))
        return data

    @abstractmethod
    def close(self) -> None:
        """Close the port; never raises."""

    @abstractmethod
    def _open(self) -> int:
        """Open the port exclusively and return its file descriptor."""

    def _ready(self, timeout: float) -> bool:
        return bool(select.select([self._handle], [], [], timeout)[0])

    def _told(self, error: OSError | ValueError) -> ScreenError:
        """The error in one line."""
        number = error.errno if isinstance(error, OSError) and error.errno else errno.EINVAL
        if number in {errno.EACCES, errno.EPERM}:
            reason = f"permission denied; {self.PERMISSION}"
        else:
            reason = _REASONS.get(number, os.strerror(number))
        return ScreenError(f"touch screen {self.port}: {reason}")


class Serial(Transport):
    """A serial line, 8N1."""

    PERMISSION = "add the user to the group that owns it (dialout)"

    def __init__(self, port: str, baud: int) -> None:
        super().__init__(port, baud)
        self._line: serial.Serial | None = None

    def _open(self) -> int:
        try:
            self._line = serial.Serial(self.port, self.baud, timeout=0, exclusive=True)
        except serial.SerialException as error:
            # Without a number: the device does not know the settings of a serial line.
            raise OSError(error.errno or errno.ENOTTY, str(error)) from error
        return int(self._line.fileno())

    def close(self) -> None:
        """Close the line."""
        if self._line is not None:
            with suppress(OSError, termios.error):
                self._line.close()
            self._line = None


class Device(Transport):
    """A device file that is read as it is."""

    def _open(self) -> int:
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


class Hidraw(Device):
    """A raw HID device: one report a reading."""

    PERMISSION = "a udev rule must give /dev/hidraw* of vendor 202e to the user"


class Evdev(Device):
    """An input event device."""

    PERMISSION = "add the user to the group that owns it (input)"


TRANSPORTS: dict[str, type[Transport]] = {"serial": Serial, "hidraw": Hidraw, "evdev": Evdev}
"""Every kind of port by the name a rig file gives it."""
