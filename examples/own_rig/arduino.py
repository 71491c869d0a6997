"""A rig of one's own: an Arduino with two servos and a camera that says where the ball is.

It sends lines `B X Y*CC` (ball, mm; `B - -*CC` where it sees none) and takes `P PHI THETA*CC`
(plate angles, deg); CC is the sum of the bytes before it, in hex. After a reset it says `READY`.
"""

import math

import serial

from ballplate.hardware import Hardware, Reading


def with_sum(text: str) -> bytes:
    """A line with its check sum."""
    return f"{text}*{sum(text.encode()) % 256:02X}\n".encode()


class Arduino(Hardware):
    """The board behind a serial port, or behind TCP if the port is `socket://HOST:PORT`."""

    watchdog = True  # its program levels the plate when it hears nothing for 0.3 s

    def __init__(self, port: str) -> None:
        self.port = port
        self.resets = 0

    def start(self) -> None:
        """Open the port, wait for the board, and bring the plate level."""
        options = {"baudrate": 115200, "timeout": 2.0, "write_timeout": 0.0}
        self.line = serial.serial_for_url(self.port, **options)
        self.line.write(with_sum("P 0 0"))
        if b"B" not in self.line.read_until(b"\n") + self.line.read_until(b"\n"):
            raise OSError(f"{self.port}: no line from the board within 2 s; is it the right port?")
        self.line.timeout = 0.0
        self.rest = b""
        self.reading = Reading(math.nan, math.nan, self.time())

    def measure(self) -> Reading:
        """The newest whole line that has arrived; lines with lost bytes are dropped."""
        *lines, self.rest = (self.rest + self.line.read(4096)).split(b"\n")
        for line in lines:
            text, _, check = line.decode("ascii", "replace").strip().partition("*")
            if text == "READY":
                self.resets += 1
            elif text.startswith("B ") and check == f"{sum(text.encode()) % 256:02X}":
                x, y = (
                    math.nan if each == "-" else float(each) / 1000 for each in text[2:].split()
                )
                self.reading = Reading(x, y, self.time())
        return self.reading

    def command(self, rates: tuple[float, float], angles: tuple[float, float]) -> None:
        """Tell the servos where to go."""
        self.line.write(with_sum("P {:.3f} {:.3f}".format(*map(math.degrees, angles))))

    def stop(self) -> None:
        """Level the plate and let the port go; the servos have no brake."""
        if hasattr(self, "line"):
            self.line.write(with_sum("P 0 0"))
            self.line.close()

    def faults(self) -> tuple[str, ...]:
        """A board that was reset has forgotten where the plate was."""
        times = "once" if self.resets == 1 else f"{self.resets} times"
        return (f"the board was reset {times}",) if self.resets else ()
