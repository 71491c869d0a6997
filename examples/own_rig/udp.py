"""A rig of one's own behind a wireless network: an ESP32 with two servos and a camera, by UDP.

Each datagram is one line, and on either way one may be lost, repeated or overtaken. So the board
numbers its lines, `B N X Y*CC` (number, ball in mm; `B N - -*CC` where it sees none), and an older
one is dropped. It takes `P PHI THETA*CC` (plate angles, deg); CC is the sum of the bytes before it,
in hex. After a reset it counts from 1 again. A board that speaks TCP needs no other class:
`arduino.py` takes `port = "socket://192.168.4.1:3333"`.
"""

import math
import socket
from contextlib import suppress

from ballplate.hardware import Hardware, Reading


def with_sum(text: str) -> bytes:
    """A line with its check sum."""
    return f"{text}*{sum(text.encode()) % 256:02X}\n".encode()


class Esp32(Hardware):
    """The board behind a UDP port."""

    watchdog = True  # its program levels the plate when it hears nothing for 0.3 s

    def __init__(self, host: str, port: int) -> None:
        self.address = host, port
        self.resets = 0

    def start(self) -> None:
        """Level the plate, which also says to the board where to answer, and wait for a line."""
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(self.address)  # datagrams of others are not heard
        self.number, self.reading = 0, Reading(math.nan, math.nan, self.time())
        self.socket.settimeout(0.2)
        for _ in range(10):  # the first command may be lost like any other
            self.socket.send(with_sum("P 0 0"))
            with suppress(TimeoutError, ConnectionRefusedError):
                self.take(self.socket.recv(64))
            if self.number:
                break
        else:
            raise OSError("{}:{}: no line from the board within 2 s".format(*self.address))
        self.socket.setblocking(False)

    def take(self, datagram: bytes) -> None:
        """Keep a line that is whole and newer than the last."""
        text, _, check = datagram.decode("ascii", "replace").strip().partition("*")
        words = text.split()
        if check != f"{sum(text.encode()) % 256:02X}" or len(words) != 4 or words[0] != "B":
            return
        number = int(words[1])
        if number <= self.number - 100:  # so far back no datagram is on its way
            self.resets += 1
        elif number <= self.number:
            return
        self.number = number
        x, y = (math.nan if each == "-" else float(each) / 1000 for each in words[2:])
        self.reading = Reading(x, y, self.time())

    def measure(self) -> Reading:
        """The newest line that has arrived."""
        with suppress(BlockingIOError, ConnectionRefusedError):
            while True:
                self.take(self.socket.recv(64))
        return self.reading

    def command(self, rates: tuple[float, float], angles: tuple[float, float]) -> None:
        """Tell the servos where to go; a datagram that finds no room is lost, the next follows."""
        with suppress(BlockingIOError, ConnectionRefusedError):
            self.socket.send(with_sum("P {:.3f} {:.3f}".format(*map(math.degrees, angles))))

    def stop(self) -> None:
        """Level the plate, three times as one may be lost, and let the port go."""
        if hasattr(self, "socket"):
            for _ in range(3):
                self.command((0.0, 0.0), (0.0, 0.0))
            self.socket.close()
            del self.socket

    def faults(self) -> tuple[str, ...]:
        """A board that was reset has forgotten where the plate was."""
        times = "once" if self.resets == 1 else f"{self.resets} times"
        return (f"the board was reset {times}",) if self.resets else ()
