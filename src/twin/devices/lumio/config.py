"""Settings of a touch screen, as a rig file gives them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from twin.devices.lumio.calibration import Calibration
from twin.devices.lumio.protocols import STREAMS
from twin.devices.lumio.transports import PRODUCTS, TRANSPORTS, ScreenError
from twin.devices.nets import check_ranges, net, relaxed_nets


@dataclass(frozen=True, kw_only=True)
class PlausibilityLimits:
    """Which positions can be those of one ball, and when it is stale, lost or frozen.

    Each is a `net`: relaxed, it is told in every run; beyond its range it is refused.

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
    """

    speed: float = net(1.5, 0.5, 5)
    slack: float = net(0.006, 0.001, 0.05)
    confirm: int = net(3, 1, 20, sense=-1)
    stale: float = net(0.06, 0.01, 1)
    lost: float = net(0.1, 0.02, 1)
    halt: float = net(0.08, 0.01, 1)
    still: int = net(4, 2, 120)
    tilt: float = net(math.radians(2), 0.01, 0.17)
    rest: float = net(0.3, 0.05, 10)

    def __post_init__(self) -> None:
        """Refuse what would be no threshold."""
        check_ranges(self, "touch.gate.")


@dataclass(frozen=True, kw_only=True)
class LumioConfig:
    """Settings of one touch screen.

    Attributes:
        port: Device path: ``/dev/ttyUSB0``, ``/dev/hidraw0``.
        transport: ``serial`` or ``hidraw``.
        protocol: ``auto``, ``microtouch``, ``elo``, ``hid-0006`` or ``hid-0007``. A raw HID device
            is read by its own report descriptor, whatever is given here; a port that shows none by
            that of the product named.
        baud: Bits per second of a serial line; eight data bits, no parity, one stop bit.
        calibration: Screen units to plate axes; None for a screen mounted square and centred, of
            the size that it says, else of the size of the model's.
        gate: What is plausible.

    Raises:
        ScreenError: Unknown transport or protocol, or a baud rate that is not positive.
    """

    port: str
    transport: str = "serial"
    protocol: str = "auto"
    baud: int = 9600
    calibration: Calibration | None = None
    gate: PlausibilityLimits = field(default_factory=PlausibilityLimits)

    def __post_init__(self) -> None:
        """Refuse what does not exist."""
        for key, allowed in (
            ("transport", tuple(TRANSPORTS)),
            ("protocol", ("auto", *STREAMS, *PRODUCTS.values())),
        ):
            value = getattr(self, key)
            if value not in allowed:
                raise ScreenError(f"touch.{key}: must be one of {', '.join(allowed)}, got {value}")
        if self.baud <= 0:
            raise ScreenError(f"touch.baud: must be positive, got {self.baud}")

    @property
    def relaxed(self) -> tuple[str, ...]:
        """Every safety net that is wider than by default, in words."""
        return tuple(relaxed_nets(self.gate, "touch.gate."))

    @property
    def capacity(self) -> float:
        """Bytes per second from which the line counts as flooded.

        A serial line: nine tenths of what it can carry, ten bits per byte. USB: several times four
        contacts at 60 reports per second.
        """
        return 0.09 * self.baud if self.transport == "serial" else 10_000.0
