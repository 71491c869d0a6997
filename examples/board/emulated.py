"""The board's real firmware in simavr, its servo pulses moving the twin's plate: try it all first.

Time is virtual: the chip executes while the host waits, so a run is the same every time. Its port
is a pseudo-terminal, opened as the board's would be.
"""

import math
import select
from collections.abc import Sequence
from pathlib import Path

import serial
from atmega import Board

from ballplate.hardware import Reading
from twin.emulator.avr import TICK_S, Chip, PulsedPlate, build_firmware
from twin.scenario.load import load

FIRMWARE = Path(__file__).with_name("firmware")
NEUTRAL_S, S_PER_RAD = 1500e-6, 1910e-6  # as mounted: of a servo, and the plate that it turns


class LockstepLine:
    """The port, of which it is known how many bytes are on their way; as `serial.Serial`."""

    def __init__(self, port: serial.Serial) -> None:
        self.port = port
        self.written = 0  # bytes for the chip since it was asked last
        self.due = 0  # bytes of the chip that are there, or will be in an instant
        self.cut = False  # whether nothing of the host reaches the chip any more
        self.closed = False

    def write(self, data: bytes) -> None:
        """Write bytes for the chip."""
        if not self.cut:
            self.port.write(data)
            self.written += len(data)

    def read(self, count: int) -> bytes:
        """All bytes of the chip until now."""
        found, count = b"", min(count, self.due)
        while len(found) < count:
            select.select([self.port], [], [])
            found += self.port.read(count - len(found))
        self.due -= count
        return found

    def close(self) -> None:
        """Read no more; the chip still has its end."""
        self.closed = True


class TwinCamera:
    """The camera of the twin, in the place of one with a port."""

    def __init__(self, board: "Emulated") -> None:
        self.board = board

    def start(self) -> None:
        """Nothing to open."""

    def measure(self) -> Reading:
        """The newest picture."""
        seen = self.board.plate.camera()
        x, y = seen.position[0].tolist() if seen.touched[0] else (math.nan, math.nan)
        now = self.board.now - self.board.owed  # up to where the plate has gone
        return Reading(x, y, now - float(seen.age[0]))

    def stop(self) -> None:
        """Nothing to close."""


class Emulated(Board):
    """The board, emulated.

    Args:
        parameters: Rig of the twin, as `--on` names it.
        controller: Folder of `ballplate export SCENARIO controller.c --real float`; the board then
            computes.
        clock_percent: By how much its clock is too fast.
        lose_percent: Of the bytes on its line, once it runs.
        defines: Numbers of `firmware/rig.h` in place of those there, `NEUTRAL_US_PHI=1490`.
    """

    def __init__(
        self,
        parameters: str = "hobby",
        controller: str = "",
        clock_percent: float = 0.0,
        lose_percent: float = 0.0,
        defines: Sequence[str] = (),
    ) -> None:
        super().__init__("")
        self.computes = bool(controller)
        self.camera = TwinCamera(self)
        self.controller = Path(controller).resolve() if controller else None
        self.defines = " ".join(defines)
        self.clock_error, self.lose = clock_percent / 100, lose_percent / 100
        self.plate = PulsedPlate(load("hold", (f"parameters={parameters}",)), NEUTRAL_S, S_PER_RAD)
        self.now, self.owed = 0.0, 0.0

    def start(self) -> None:
        """Put a chip to work, then open its port."""
        self.chip = self.make_chip()
        self.port = self.chip.port
        super().start()
        self.chip.tell(f"lose {self.lose}")

    def make_chip(self) -> Chip:
        """A chip that begins to execute the firmware."""
        return Chip(build_firmware(FIRMWARE, self.controller, self.defines), self.clock_error)

    def open_port(self) -> LockstepLine:
        """Open the port of the chip."""
        return LockstepLine(super().open_port())

    def time(self) -> float:
        """Virtual time, s."""
        return self.now

    def wait(self, seconds: float) -> None:
        """Let chip, plate and ball go on."""
        self.now += seconds
        self.owed += seconds
        while self.owed > TICK_S - 1e-9:
            self.owed -= TICK_S
            self.advance()

    def advance(self) -> None:
        """Let chip, plate and ball go on by a tick."""
        count, pulses = self.chip.run(TICK_S, self.line.written)
        self.line.written = 0
        self.line.due += count
        if self.line.closed:
            self.line.read(count)
        for axis, width in pulses:
            self.plate.pulse(axis, width)
        self.plate.advance()
