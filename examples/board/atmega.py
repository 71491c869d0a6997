"""The board of `firmware/firmware.c` as hardware of one's own: servos, and a camera of its own.

Either this computer computes and sends plate angles to the board, or it sends where the ball is
(`computes`), and the controller in the board's firmware moves the plate. A board that computes
reports where it takes the plate to be, which is then recorded as measured; the controller on this
computer runs along, is recorded, and commands nothing.
"""

import binascii
import math
import runpy
import struct
from pathlib import Path
from typing import NamedTuple

import serial

from ballplate.hardware import Hardware, Reading, ScreenHardware

BAUD = 115200
VERSION = 1
FRAME_START = 0xB5
MAX_CONTENT_BYTES = 32
UNIT_RAD, UNIT_M = 1e-5, 1e-5
PULSE_TICK_US = 0.5
BOOTLOADER_S = 2.5  # opening its port resets an Arduino, whose bootloader then listens for a while
ANSWER_TIMEOUT_S = 4.0
STATUS_TIMEOUT_S = 0.25
LEVELLED = {
    4: "heard nothing of this computer for a while",
    8: "saw no ball in its area",
    16: "got no number from its controller",
    32: "was reset",
}
UNFIT = {
    0: "was flashed without a controller",
    2: "has a controller that was exported for another rig.period than 0.02 s",
}
RESETS = {1: "power-on", 2: "its reset pin", 4: "brown-out", 8: "its watchdog"}


def frame(content: bytes) -> bytes:
    """A frame with its length and check sum."""
    checked = bytes([len(content)]) + content
    return bytes([FRAME_START]) + checked + struct.pack("<H", binascii.crc_hqx(checked, 0))


def take_frames(buffer: bytearray) -> list[bytes]:
    """The contents of the whole frames in a buffer; what may become one stays in it.

    After a failed check sum the next frame is sought within its bytes.
    """
    found = []
    while buffer:
        length = buffer[1] if len(buffer) > 1 else 2
        if buffer[0] != FRAME_START or not 2 <= length <= MAX_CONTENT_BYTES:
            del buffer[0]
            continue
        if len(buffer) < length + 4:
            break
        content = bytes(buffer[2 : length + 2])
        if frame(content) == buffer[: length + 4]:
            found.append(content)
            del buffer[: length + 4]
        else:
            del buffer[0]
    return found


class Status(NamedTuple):
    """What the board reports once per servo frame; `struct status` of the firmware."""

    number: int
    state: int
    cause: int
    time_ms: int
    valid: int
    invalid: int
    overruns: int
    angle: tuple[float, float]  # commanded plate angles, rad
    plate: tuple[float, float]  # where it takes the plate to be, rad
    pulse_us: tuple[float, float]
    step_us: int

    @classmethod
    def of(cls, content: bytes) -> "Status":
        """The status of the content of a frame."""
        *head, a, b, c, d, e, f, step = struct.unpack("<xBBBHHHHhhhhHHH", content)
        angle, plate = (UNIT_RAD * a, UNIT_RAD * b), (UNIT_RAD * c, UNIT_RAD * d)
        return cls(*head, angle, plate, (PULSE_TICK_US * e, PULSE_TICK_US * f), step)


def limited(value: float, unit: float) -> int:
    """A number in units, as 16 bits can have it."""
    return max(-32767, min(32767, round(value / unit)))


class Board(Hardware):
    """The board behind a serial port.

    Args:
        port: Its serial port.
        camera: That of a camera as in `own_rig/camera.py`; without one the board is servos only,
            for the table `[drives]` of a rig file.
        computes: Whether the board computes; it then needs the camera.
    """

    watchdog = True  # 100 ms, and a second one for its own program

    def __init__(self, port: str, camera: str = "", computes: bool = False) -> None:
        if computes and not camera:
            raise ValueError("computes: needs the camera")
        self.port, self.computes = port, computes
        self.camera = make_camera(camera) if camera else None
        self.ball = Reading(math.nan, math.nan, -math.inf)
        self.status: Status | None = None
        self.number = 0

    def start(self) -> None:
        """Open the port, and bring the plate level."""
        self.line = self.open_port()
        self.buffer, self.answer, self.status = bytearray(), b"", None
        begin = self.time()
        until = begin + ANSWER_TIMEOUT_S
        while not self.answer:
            if self.time() > until:
                raise OSError(
                    f"{self.port}: no answer from the board within {ANSWER_TIMEOUT_S:g} s; is it "
                    "the right port, and flashed?"
                )
            if self.status or self.time() > begin + BOOTLOADER_S:
                self.send(b"L")
            self.wait(0.05)
            self.receive()
        _, _, _, version, control = self.answer
        if version != VERSION:
            raise OSError(f"{self.port}: the board speaks version {version}, this is {VERSION}")
        if self.computes and control in UNFIT:
            raise OSError(f"{self.port}: computes: the board {UNFIT[control]}")
        self.status = None
        while self.status is None or self.status.state:
            if self.time() > until:
                raise OSError(f"{self.port}: the board says nothing more")
            self.wait(0.02)
            self.receive()
        if self.camera:
            self.camera.start()

    def measure(self) -> Reading:
        """The ball as the camera sees it; plate angles of a board that computes."""
        self.receive()
        if self.camera:
            self.ball = self.camera.measure()
            if self.computes and self.status:
                return self.ball._replace(phi=self.status.plate[0], theta=self.status.plate[1])
            return self.ball
        return Reading(math.nan, math.nan, self.heard)

    def command(self, rates: tuple[float, float], angles: tuple[float, float]) -> None:
        """Tell the board where the plate goes, or where the ball is."""
        if self.computes:
            seen = math.isfinite(self.ball.x) and math.isfinite(self.ball.y)
            place = (limited(each if seen else 0.0, UNIT_M) for each in self.ball[:2])
            age = round(min(255, max(0, 1e3 * (self.time() - self.ball.at))))
            self.send(b"B", struct.pack("<hhBB", *place, age, seen))
        else:
            self.send(b"A", struct.pack("<hh", *(limited(each, UNIT_RAD) for each in angles)))

    def stop(self) -> None:
        """Level the plate and let the port go; the servos keep their torque."""
        try:
            if hasattr(self, "line"):
                try:
                    self.send(b"L")
                finally:
                    self.line.close()
        finally:
            if self.camera:
                self.camera.stop()

    def faults(self) -> tuple[str, ...]:
        """Why the board has levelled the plate, or that it says nothing."""
        if self.status is None:
            return ()
        found = [words for bit, words in LEVELLED.items() if self.status.state & bit]
        if found and self.status.state & 32:
            causes = [words for bit, words in RESETS.items() if self.status.cause & bit]
            found = [f"was reset: {', '.join(causes) or 'cause unknown'}"]
        if self.time() - self.heard > STATUS_TIMEOUT_S:
            found.append(f"has said nothing for {STATUS_TIMEOUT_S:g} s")
        return tuple(f"the board {words}" for words in found)

    def open_port(self) -> serial.Serial:
        """Open the port; reading and writing never wait."""
        return serial.Serial(self.port, BAUD, timeout=0.0, write_timeout=0.0)

    def send(self, kind: bytes, content: bytes = b"") -> None:
        """Send a frame with the next number."""
        self.number = self.number % 255 + 1
        self.line.write(frame(kind + bytes([self.number]) + content))

    def receive(self) -> None:
        """Take in what has arrived."""
        self.buffer += self.line.read(4096)
        for content in take_frames(self.buffer):
            if content[:1] == b"S" and len(content) == struct.calcsize("<BBBBHHHHhhhhHHH"):
                self.status, self.heard = Status.of(content), self.time()
            elif content[:1] == b"R" and content[1] and len(content) == 5:
                self.answer = content


def make_camera(port: str) -> ScreenHardware:
    """The camera of `own_rig` on a serial port."""
    file = Path(__file__).resolve().parents[1] / "own_rig" / "camera.py"
    return runpy.run_path(str(file))["Camera"](port)
