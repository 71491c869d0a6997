"""Settings of a touch screen, as a rig file gives them: its port, its mounting, what is plausible.

A port is a serial line or a raw HID device; also where Linux has it. Opening one needs a POSIX
system, a raw HID device Linux; importing does not.
"""

from __future__ import annotations

import errno
import json
import math
import os
import select
import time
from abc import ABC, abstractmethod
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from math import atan2, degrees, hypot, pi
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from controllers.arrays import Array
from twin.base.data_file import parse_json
from twin.base.errors import ScenarioError, TwinError
from twin.devices.common import Ranged, claim, in_words, net, range_field
from twin.devices.lumio.protocols import (
    STREAM_DECODERS,
    Decoder,
    DescriptorError,
    HidDecoder,
    TouchLayout,
)
from twin.hal.interface import SCREEN_SIZE_M

VENDOR_ID = 0x202E
HID_PANELS = ("hid-0006", "hid-0007", "hid-timed")
"""Protocols of the panels with report descriptors in ``panels.toml``."""
HIDRAW_CLASS = Path("/sys/class/hidraw")
"""Where Linux describes raw HID devices; anyone may read it."""
UDEV_RULES = Path(__file__).with_name("70-ballplate-touch.rules")
"""Rules that let the user at the computer read a panel, and keep it from moving the pointer."""


def touch_screens(root: Path = HIDRAW_CLASS) -> list[str]:
    """Ports of the touch screens among the interfaces of the Lumio panels plugged in.

    A panel may have several interfaces: screen, mouse, keyboard, ...

    Args:
        root: Where the kernel describes raw HID devices.
    """
    found = []
    for folder in sorted(root.glob("hidraw*"), key=lambda path: (len(path.name), path.name)):
        with suppress(OSError, KeyError, ValueError):  # unplugged, or of a different kind
            text = (folder / "device" / "uevent").read_text(encoding="utf-8")
            event = dict(line.split("=", 1) for line in text.splitlines() if "=" in line)
            if int(event["HID_ID"].split(":")[1], 16) == VENDOR_ID and _layout(folder):
                found.append(f"/dev/{folder.name}")
    return found


def _layout(folder: Path) -> TouchLayout | None:
    return TouchLayout.of((folder / "device" / "report_descriptor").read_bytes())


class ScreenError(TwinError, OSError):
    """A touch screen's port cannot be opened or is lost."""


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
            ScreenError: Absent, not permitted, busy or of a wrong kind; or no POSIX system.
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
        """Bytes that have arrived, or none after a timeout in s.

        Raises:
            ScreenError: The port is lost.
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
            ScreenError: Its report descriptor is not of a touch screen.
        """
        return None

    def close(self) -> None:
        """Close the port; never raises."""
        self._handle = -1
        with suppress(Exception):  # of whatever kind: the port may be lost
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
    """A raw HID device: one report per read, laid out as its descriptor states."""

    PERMISSION = "a udev rule must give it to the user; `ballplate doctor --udev` prints one"

    def decoder(self) -> Decoder | None:
        """A decoder by the report descriptor; None for a port that has none, as on a virtual rig.

        Raises:
            ScreenError: The device is not a touch screen.
        """
        try:
            layout = _layout(HIDRAW_CLASS / Path(self.port).resolve().name)
        except OSError:
            return None
        except DescriptorError as error:
            reason = f"its report descriptor cannot be read: {error}"
            raise ScreenError(f"touch screen {self.port}: {reason}") from error
        if layout is None:
            others = ", ".join(touch_screens())
            hint = f"; the touch screen is {others}" if others else ""
            raise ScreenError(f"touch screen {self.port}: is not a touch screen{hint}")
        return HidDecoder(layout)

    def _open(self) -> int:
        handle = claim(self.port, os.O_RDONLY)
        self._opened.callback(os.close, handle)
        return handle


PORT_CLASSES: dict[str, type[Transport]] = {"serial": SerialPort, "hidraw": HidrawDevice}
"""Every kind of port by the name a rig file gives it."""


_CALIBRATION_REMEDY = "run `ballplate calibrate touch`"


class CalibrationError(TwinError, ValueError):
    """A calibration cannot be made from what was given."""


@dataclass(frozen=True)
class Calibration:
    """Plate position = matrix . screen position + origin.

    Attributes:
        matrix: m in plate axes per screen unit; a screen unit is the whole range of an axis.
        origin: Where on the plate the screen's (0, 0) is, m in plate axes.
    """

    matrix: tuple[tuple[float, float], tuple[float, float]]
    origin: tuple[float, float]

    def __post_init__(self) -> None:
        """Refuse what cannot be inverted."""
        (a, b), (c, d) = self.matrix
        if not np.isfinite([a, b, c, d, *self.origin]).all() or abs(a * d - b * c) < 1e-6:
            raise CalibrationError(
                f"calibration: matrix {self.matrix} must be finite and cover an area"
            )

    @classmethod
    def nominal(cls, size: tuple[float, float] = (SCREEN_SIZE_M[0], SCREEN_SIZE_M[1])) -> Self:
        """A screen mounted square and centred on the plate, its second axis counting downwards.

        Args:
            size: Sides of the sensing area along the plate's x and y, m.
        """
        x, y = size
        return cls(((x, 0.0), (0.0, -y)), (-x / 2, y / 2))

    def plate(self, x: float, y: float) -> tuple[float, float]:
        """Position in m in plate axes of one in screen units."""
        (a, b), (c, d) = self.matrix
        return a * x + b * y + self.origin[0], c * x + d * y + self.origin[1]

    def screen(self, x: float, y: float) -> tuple[float, float]:
        """Position in screen units of one in m in plate axes."""
        (a, b), (c, d) = self.matrix
        x, y = x - self.origin[0], y - self.origin[1]
        area = a * d - b * c
        return (d * x - b * y) / area, (a * y - c * x) / area


def read_calibration(path: Path) -> Calibration:
    """The calibration in a file that `CalibrationFit.save` wrote.

    Raises:
        CalibrationError: If the file is missing, or is not such a calibration.
    """
    try:
        data = parse_json(path.read_text(encoding="utf-8"))
        (a, b), (c, d) = data["matrix_m"]
        x, y = data["origin_m"]
        numbers = [a, b, c, d, x, y]
        if not all(type(each) in {int, float} for each in numbers):
            raise TypeError("matrix_m and origin_m must be numbers")
        a, b, c, d, x, y = map(float, numbers)
        return Calibration(((a, b), (c, d)), (x, y))
    except OSError as error:
        raise CalibrationError(f"{path}: {error.strerror}; {_CALIBRATION_REMEDY}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(
            f"{path}: not a calibration ({error}); {_CALIBRATION_REMEDY}"
        ) from error


@dataclass(frozen=True)
class CalibrationFit:
    """A calibration, and its residuals.

    Attributes:
        calibration: Screen units to plate axes.
        points: Where the points are, m in plate axes, shape (K, 2).
        left: Where the calibration puts the points less where they are, m, shape (K, 2).
    """

    calibration: Calibration
    points: Array
    left: Array

    @property
    def distances(self) -> Array:
        """How far from each point the calibration puts it, m, shape (K,)."""
        return np.asarray(np.hypot(self.left[:, 0], self.left[:, 1]))

    @property
    def rms(self) -> float:
        """Root mean square of these distances, m."""
        return float(np.sqrt(np.mean(self.distances**2)))

    @property
    def mounting(self) -> Mounting:
        """The screen's mounting by the calibration."""
        return Mounting.of(self.calibration)

    def as_dict(self) -> dict[str, Any]:
        """Calibration and residuals, for ``--json``."""
        pairs = zip((1e3 * self.points).tolist(), (1e3 * self.left).tolist(), strict=True)
        return {
            **asdict(self.mounting),
            "points": len(self.points),
            "rms_mm": round(1e3 * self.rms, 4),
            "residuals": [{"point_mm": point, "off_mm": off} for point, off in pairs],
        }

    def save(self, path: Path) -> None:
        """Write the file that a rig file names as ``touch.calibration_file``."""
        made = {"made": "measured on a rig", "date": time.strftime("%Y-%m-%d"), **self.as_dict()}
        matrix, origin = self.calibration.matrix, self.calibration.origin
        data = {"provenance": made, "matrix_m": matrix, "origin_m": origin}
        path.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")


def fit(screen: ArrayLike, plate: ArrayLike) -> CalibrationFit:
    """The calibration that suits known points best, by least squares.

    Args:
        screen: Readings of the screen, screen units, shape (K, 2), K at least 3.
        plate: Where the points are, m in plate axes, shape (K, 2).

    Raises:
        CalibrationError: All points are on one line.
    """
    seen, true = np.asarray(screen, float), np.asarray(plate, float)
    system = _system(seen)
    solution = np.linalg.lstsq(system, true, rcond=1e-6)[0]
    if min(np.linalg.matrix_rank(_system(each), rtol=1e-6) for each in (seen, true)) < 3:
        raise CalibrationError("calibration: the points must not be on one line")
    (a, c), (b, d), origin = solution.tolist()
    calibration = Calibration(((a, b), (c, d)), (origin[0], origin[1]))
    return CalibrationFit(calibration, true, system @ solution - true)


def _system(points: Array) -> Array:
    return np.column_stack([points, np.ones(len(points))])


@dataclass(frozen=True)
class Mounting:
    """The screen's mounting by a calibration.

    Attributes:
        size_m: Sides of the sensing area along the plate's x and y, m.
        swapped: Whether the screen's first axis runs along the plate's y.
        mirrored_x: Whether the screen's position along the plate's x counts backwards.
        mirrored_y: The same along y.
        turn_deg: Angle from the mounting that these three describe, deg about the plate's normal.
        skew_deg: By how much the screen's axes differ from a right angle, deg.
        centre_m: Where on the plate the middle of the screen is, m.
    """

    size_m: tuple[float, float]
    swapped: bool
    mirrored_x: bool
    mirrored_y: bool
    turn_deg: float
    skew_deg: float
    centre_m: tuple[float, float]

    @classmethod
    def of(cls, calibration: Calibration) -> Self:
        """The mounting that is nearest to square, and the turn from it."""
        (a, b), (c, d) = calibration.matrix
        swapped = abs(c) + abs(b) > abs(a) + abs(d)
        # sides along the plate's x and y, whichever of the screen's axes they are
        x, y = ((b, d), (a, c)) if swapped else ((a, c), (b, d))
        mirrored_x, mirrored_y = x[0] < 0, y[1] < 0
        along_x = _wrap_angle(atan2(x[1], x[0]) - (pi if mirrored_x else 0.0))
        along_y = _wrap_angle(atan2(y[1], y[0]) - (-pi / 2 if mirrored_y else pi / 2))
        return cls(
            (hypot(*x), hypot(*y)),
            swapped,
            mirrored_x,
            mirrored_y,
            degrees(along_x + along_y) / 2,
            degrees(along_y - along_x),
            calibration.plate(0.5, 0.5),
        )

    @property
    def lines(self) -> tuple[str, ...]:
        """It in words, a line for each of scale, axes, turn and place."""
        width, height = (1e3 * side for side in self.size_m)
        first, second = (
            f"the plate's {'-' if mirrored else '+'}{name}"
            for name, mirrored in (("x", self.mirrored_x), ("y", self.mirrored_y))
        )
        if self.swapped:
            first, second = second, first
        return (
            f"scale: sensing area {width:.1f} x {height:.1f} mm along the plate's x and y",
            f"axes: the screen's x runs along {first}, its y along {second}",
            f"turn: {self.turn_deg:+.2f} deg, skew {self.skew_deg:+.2f} deg",
            f"offset: its middle is at x {1e3 * self.centre_m[0]:+.2f}, "
            f"y {1e3 * self.centre_m[1]:+.2f} mm",
        )


def _wrap_angle(angle: float) -> float:
    """An angle in -pi..pi."""
    return (angle + pi) % (2 * pi) - pi


@dataclass(frozen=True, kw_only=True)
class PlausibilityLimits(Ranged):
    """Limits of a plausible ball position, and of one that is stale, lost or frozen.

    Each is a `net`: relaxed, it is reported in every run; beyond its range it is refused.

    Attributes:
        speed: Fastest ball, m/s; a run down the whole plate at 10 deg ends at 1.2 m/s.
        slack: Jitter of a position, m.
        confirm: Reports in a row, consistent with each other, that make a ball believed: at the
            start, and where it has jumped.
        stale: Seconds without a report after which a touching ball's position is stale; a resting
            ball is reported every 17 ms, with gaps of up to 47 ms in recordings.
        lost: Seconds without an accepted position after which the ball counts as lost.
        halt: Speed in m/s from which no ball stops dead.
        still: Reports without any motion, after a ball was faster than that, which show that the
            touch is frozen.
        tilt: Plate angle in rad on which no ball rests.
        rest: Seconds of rest on a plate tilted further than that, which show the same.
        late: Seconds by which reports may arrive later after their scan than the promptest ones,
            where a panel gives a scan time.
    """

    keys = "touch.gate."
    speed: float = net(1.5, 0.5, 5)
    slack: float = net(0.006, 0.001, 0.05)
    confirm: int = net(3, 1, 20, sense=-1)
    stale: float = net(0.06, 0.01, 1)
    lost: float = net(0.1, 0.02, 1)
    halt: float = net(0.08, 0.01, 1)
    still: int = net(4, 2, 120)
    tilt: float = net(math.radians(2), 0.01, 0.17)
    rest: float = net(0.3, 0.05, 10)
    late: float = net(0.03, 0.01, 1)


@dataclass(frozen=True, kw_only=True)
class LumioConfig(Ranged):
    """Settings of one touch screen.

    Attributes:
        port: Device path: ``/dev/ttyUSB0``, ``/dev/hidraw0``.
        transport: ``serial`` or ``hidraw``.
        protocol: ``auto``, ``microtouch``, ``elo``, ``hid-0006``, ``hid-0007`` or ``hid-timed``. A
            raw HID device is read by its own report descriptor, whatever is given here; a port that
            shows none by the descriptor of the panel named.
        baud: Bits per second of a serial line; eight data bits, no parity, one stop bit.
        calibration: Screen units to plate axes; None for a screen mounted square and centred, of
            the size that it reports, else of the size of the model's.
        calibration_file: What `ballplate calibrate touch` wrote, instead of ``calibration``; who
            opens the screen has read it.
        gate: What is plausible.

    Raises:
        ScenarioError: Unknown protocol, or a baud rate that none has.
    """

    keys = "touch."
    port: str
    transport: Literal["serial", "hidraw"] = "serial"
    protocol: str = "auto"
    baud: int = range_field(9600, 1, 1e12)
    calibration: Calibration | None = None
    calibration_file: str | None = None
    gate: PlausibilityLimits = field(default_factory=PlausibilityLimits)

    def __post_init__(self) -> None:
        """Refuse what does not exist."""
        super().__post_init__()
        known = "auto", *STREAM_DECODERS, *HID_PANELS
        if self.protocol not in known:
            raise ScenarioError(
                f"touch.protocol: must be one of {', '.join(known)}, got {self.protocol}"
            )

    @property
    def capacity(self) -> float:
        """Bytes per second from which the line counts as flooded.

        A serial line: nine tenths of its capacity, ten bits per byte. USB: several times four
        contacts at 60 reports per second.
        """
        return 0.09 * self.baud if self.transport == "serial" else 10_000.0
