"""A camera of one's own: whatever finds the ball sends lines `B X Y*CC` on a serial port.

X and Y are in mm from the middle of the plate, `B - -*CC` where it sees no ball; CC is the sum of
the bytes before it, in hex. After a restart it says `READY`.
"""

import math

import serial

from ballplate.hardware import Reading, ScreenHardware


class Camera(ScreenHardware):
    """The camera behind a serial port; the servos are other devices."""

    def __init__(self, port: str) -> None:
        self.port = port
        self.restarts = 0

    def start(self) -> None:
        """Open the port, and wait for a picture."""
        self.line = serial.Serial(self.port, 115200, timeout=2.0)
        if b"B" not in self.line.read_until(b"\n") + self.line.read_until(b"\n"):
            raise OSError(f"{self.port}: no line from the camera within 2 s; is it the right port?")
        self.line.timeout = 0.0
        self.rest = b""
        self.reading = Reading(math.nan, math.nan, self.time())

    def measure(self) -> Reading:
        """The newest whole line that has arrived; lines with lost bytes are dropped."""
        *lines, self.rest = (self.rest + self.line.read(4096)).split(b"\n")
        for line in lines:
            text, _, check = line.decode("ascii", "replace").strip().partition("*")
            if text == "READY":
                self.restarts += 1
            elif text.startswith("B ") and check == f"{sum(text.encode()) % 256:02X}":
                x, y = (
                    math.nan if each == "-" else float(each) / 1000 for each in text[2:].split()
                )
                self.reading = Reading(x, y, self.time())
        return self.reading

    def stop(self) -> None:
        """Let the port go."""
        if hasattr(self, "line"):
            self.line.close()

    def faults(self) -> tuple[str, ...]:
        """A camera that was restarted may stand elsewhere."""
        return (f"the camera was restarted {self.restarts} times",) if self.restarts else ()
