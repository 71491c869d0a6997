"""Servos of one's own: a board on a serial port takes `P PHI THETA*CC` (plate angles, deg).

CC is the sum of the bytes before it, in hex. The plate has no encoder.
"""

import math

import serial

from ballplate.hardware import ServoHardware


def with_sum(text: str) -> bytes:
    """A line with its check sum."""
    return f"{text}*{sum(text.encode()) % 256:02X}\n".encode()


class Servos(ServoHardware):
    """The servos behind a serial port; the touch screen or camera is another device."""

    watchdog = True  # the board's program levels the plate when it hears nothing for 0.3 s

    def __init__(self, port: str) -> None:
        self.port = port

    def start(self) -> None:
        """Open the port, and bring the plate level."""
        self.line = serial.Serial(self.port, 115200, write_timeout=0.0)
        self.line.write(with_sum("P 0 0"))

    def command(self, rates: tuple[float, float], angles: tuple[float, float]) -> None:
        """Command where the servos go."""
        self.line.write(with_sum("P {:.3f} {:.3f}".format(*map(math.degrees, angles))))

    def stop(self) -> None:
        """Level the plate and let the port go; the servos have no brake."""
        if hasattr(self, "line"):
            self.line.write(with_sum("P 0 0"))
            self.line.close()
