"""What a rig file says of its touch screen."""

from __future__ import annotations

from dataclasses import dataclass, field

from twin.devices.lumio.calibration import Calibration
from twin.devices.lumio.detect import DECODERS
from twin.devices.lumio.gate import Gate
from twin.devices.lumio.transports import TRANSPORTS, ScreenError


@dataclass(frozen=True, kw_only=True)
class LumioConfig:
    """A touch screen.

    Attributes:
        port: Device path: ``/dev/ttyUSB0``, ``/dev/hidraw0``, ``/dev/input/event3``.
        transport: ``serial``, ``hidraw`` or ``evdev``.
        protocol: ``auto``, ``microtouch``, ``elo``, ``hid-0006``, ``hid-0007`` or ``evdev``.
        baud: Bits a second of a serial line; eight data bits, no parity, one stop bit.
        calibration: Screen units to plate.
        gate: What is plausible.

    Raises:
        ScreenError: Unknown transport or protocol, or a baud rate that is not positive.
    """

    port: str
    transport: str = "serial"
    protocol: str = "auto"
    baud: int = 9600
    calibration: Calibration = field(default_factory=Calibration.nominal)
    gate: Gate = field(default_factory=Gate)

    def __post_init__(self) -> None:
        """Refuse what does not exist."""
        for key, allowed in (
            ("transport", tuple(TRANSPORTS)),
            ("protocol", ("auto", *DECODERS)),
        ):
            value = getattr(self, key)
            if value not in allowed:
                raise ScreenError(f"touch.{key}: must be one of {', '.join(allowed)}, got {value}")
        if self.baud <= 0:
            raise ScreenError(f"touch.baud: must be positive, got {self.baud}")
        if (self.transport == "evdev") != (self.protocol == "evdev"):
            raise ScreenError("touch.protocol: evdev goes with touch.transport evdev, and only so")

    @property
    def capacity(self) -> float:
        """Bytes a second from which the line counts as flooded.

        A serial line: nine tenths of what it can carry, ten bits a byte. USB: several times four
        contacts at 60 reports a second.
        """
        return 0.09 * self.baud if self.transport == "serial" else 10_000.0
