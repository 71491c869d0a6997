"""Makes firmware.md: the board of `examples/board`, its memory, its runs, and what goes wrong.

uv run python docs/firmware.py
It needs gcc-avr, avr-libc, libsimavr-dev and gcc, and takes minutes. The firmware is the real one,
executed in virtual time; faults are evaluated as those of `own_faults`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

import ballplate as bp
from controllers.arrays import Array
from docs import own_faults
from docs.own_faults import CONFIG, LIMITS, PERIOD, WATCHDOG, Rig, Row, sets
from docs.pages import HERE, filled, write
from docs.safety import row_cells
from twin.board.program import CONTROLLER_NAME
from twin.board.source import sources
from twin.devices import own
from twin.devices.own import OwnScreen, OwnServos
from twin.devices.realtime import RealTimeClock, Scheduling
from twin.emulator.avr import (
    CLOCK_HZ,
    FLASH_BYTES,
    RAM_BYTES,
    PulsedPlate,
    Size,
    build_firmware,
    size_of,
)
from twin.hal.cams import FixedRatio
from twin.run.controller_building import control_of
from twin.safety.fault_row import FAULT_HEADINGS, FaultRow
from twin.scenario.load import load

EXAMPLE = Path(__file__).parents[1] / "examples" / "board"
sys.path.append(str(EXAMPLE))
BOARD = own_faults.module_of(EXAMPLE / "atmega.py")
EMULATED = own_faults.module_of(EXAMPLE / "emulated.py")
HOST_TIMEOUT_S, SERVO_FRAME_S, CHIP_WATCHDOG_S = 0.1, 0.02, 16384 / 128e3
"""Times of the firmware: host silent, from one pulse to the next, program silent."""
STATUS_S = SERVO_FRAME_S + 30 * 10 / BOARD.BAUD
"""Longest time in s until a report of the board arrives: its 30 bytes follow a pulse."""
JUNK = b"\xb5\x20"
"""What looks like the beginning of a long frame, and is none."""
LAWS = ("pid", "lqr")
"""Scenarios of the example for a board that computes."""


class ObservedLine(EMULATED.LockstepLine):  # type: ignore[name-defined,misc]
    """The port of the chip, with what goes wrong on it, and what the plate does."""

    def __init__(self, port: Any, board: ObservedBoard) -> None:
        super().__init__(port)
        self.board = board
        self.trace: list[tuple[float, ...]] = []
        """As of `own_faults.Line`."""
        self.told: Callable[[], Array] = lambda: np.zeros(2)
        self.gone = False
        """Whether the cable is pulled."""
        self.junk = 0
        """Bytes without sense that are sent with the next frame."""
        self.heard, self.levelled = -np.inf, False
        """When the board was sent something last, s, and whether that was to level the plate."""

    @property
    def now(self) -> float:
        """Virtual time, s."""
        return float(self.board.now)

    def write(self, data: bytes) -> None:
        """Write a frame, behind what has no sense."""
        if self.gone:
            raise OSError("device disconnected")
        junk, self.junk = self.junk, 0
        super().write((junk // 2) * JUNK + data)
        if not self.cut:
            self.heard, self.levelled = self.now, data[2:3] == b"L"

    def read(self, count: int) -> bytes:
        """All bytes of the chip until now; none once the cable is pulled."""
        found: bytes = super().read(count)
        if self.gone and not self.closed:
            raise OSError("device disconnected")
        return found


class ObservedBoard(EMULATED.Emulated):  # type: ignore[name-defined,misc]
    """The emulated board of the example, followed.

    Args:
        before: The board that is to be used again, its chip running.
        options: As of the example's class.
    """

    def __init__(self, before: ObservedBoard | None = None, **options: Any) -> None:
        self.plate: PulsedPlate
        super().__init__(**options)
        self.levelled = True
        """Whether the plate was commanded level before the stop."""
        self._before, self._angles = before, (0.0, 0.0)
        if before is not None:
            self.plate = before.plate
            self.plate.devices.place(np.zeros((1, 4)))

    def make_chip(self) -> Any:
        """The chip: one that runs already, if there was a board before."""
        return super().make_chip() if self._before is None else self._before.chip

    def open_port(self) -> ObservedLine:
        """Open the port of the chip."""
        if self._before is not None:
            self._before.line.port.close()
        return ObservedLine(BOARD.Board.open_port(self), self)

    def command(self, rates: tuple[float, float], angles: tuple[float, float]) -> None:
        """Command, and keep it."""
        self._angles = angles
        super().command(rates, angles)

    def stop(self) -> None:
        """Stop, and keep what was before."""
        self.levelled = max(map(abs, self._angles)) < own_faults.LEVEL
        super().stop()

    def advance(self) -> None:
        """Let a tick pass, and look at the plate."""
        super().advance()
        phi, theta, x, y = self.plate.state[[2, 6, 0, 4]]
        line, now = self.line, self.now - self.owed
        alone = not line.levelled and now - line.heard > HOST_TIMEOUT_S
        astray = float(np.abs(line.told() - (phi, theta)).max())
        line.trace.append((now, phi, theta, x, y, alone, astray))


def tells(command: str) -> Callable[[Any], None]:
    """A fault that is a command to the program around simavr."""

    def act(line: ObservedLine) -> None:
        line.board.chip.tell(command)

    return act


ROWS = (
    Row("Of the bytes 3 % get lost, in both directions", tells("lose 0.03")),
    Row("300 bytes without sense come at once, the buffer has 64", sets(junk=300)),
    Row("The board browns out", tells("reset 4"), own.REPORTED, STATUS_S),
    Row(
        *("The board's program hangs", tells("hang")),
        *(own.REPORTED, CHIP_WATCHDOG_S + STATUS_S),
    ),
    Row(
        *("Nothing of the host arrives any more", sets(cut=True)),
        *(own.REPORTED, HOST_TIMEOUT_S + STATUS_S),
        by=WATCHDOG,
    ),
    Row("The cable is pulled", sets(gone=True), own.FAILED, by=WATCHDOG),
    Row("The chip's clock becomes 1 % fast", tells(f"clock {1.01 * CLOCK_HZ}")),
    Row("The chip's clock becomes 1 % slow", tells(f"clock {0.99 * CLOCK_HZ}")),
)
"""Every row."""


def switched_on(row: Row, board: ObservedBoard | None = None) -> tuple[ObservedBoard, Rig]:
    """Hardware and rig of a row, on a board that has been there before if one is given."""
    hardware = ObservedBoard(board)
    servos = OwnServos(hardware, CONFIG, LIMITS, PERIOD)
    start = hardware.start

    def opened() -> None:
        start()
        hardware.line.told = lambda: servos.motor()[0]

    hardware.start = opened
    rig = Rig(
        servos=servos,
        screen=OwnScreen(servos),
        clock=RealTimeClock(PERIOD, spin=0.0, now=hardware.time, sleep=hardware.wait),
        transmission=FixedRatio(),
        limits=LIMITS,
        patience=1.0,
        scheduling=lambda: nullcontext(Scheduling(False, False, ("virtual time",))),
    )
    return hardware, rig


def carried_out(row: Row) -> FaultRow:
    """A row as measured and evaluated."""
    return own_faults.carried_out(row, switched_on, HOST_TIMEOUT_S + SERVO_FRAME_S)


class Computed(NamedTuple):
    """A law on this computer and on the board.

    Attributes:
        law: Its name.
        errors: Tracking error of a run on the twin, on the emulated board with this computer
            computing, and with the board computing; how a run ended that did not finish.
        size: Memory of the firmware with the law.
        step_ms: Median and longest computing time of a period, ms.
    """

    law: str
    errors: list[str]
    size: Size
    step_ms: tuple[float, float]


def export(law: str, folder: Path, settings: Sequence[str] = ()) -> None:
    """Write the controller of a scenario of the example, in float, into a folder."""
    control = control_of(load(str(EXAMPLE / f"{law}.toml"), settings))
    for name, text in sources(CONTROLLER_NAME, control, "float").items():
        if name in {f"{CONTROLLER_NAME}.c", f"{CONTROLLER_NAME}.h"}:
            (folder / name).write_text(text, encoding="utf-8")


def step_times(folder: Path, periods: int = 150) -> list[float]:
    """Computing times in ms of a board that holds a ball, with the controller of a folder."""
    board, found = ObservedBoard(controller=str(folder)), []
    board.start()
    for _ in range(periods):
        board.measure()
        board.command((0.0, 0.0), (0.0, 0.0))
        board.wait(SERVO_FRAME_S)
        if board.status and board.status.step_us:
            found.append(1e-3 * board.status.step_us)
    board.stop()
    return found


def computed(law: str) -> Computed:
    """A law, run in the three ways."""
    scenario = str(EXAMPLE / f"{law}.toml")
    with TemporaryDirectory() as name:
        folder = Path(name)
        export(law, folder)
        rig = folder / "rig.toml"
        text = (EXAMPLE / "emulated_computing.toml").read_text(encoding="utf-8")
        text = text.replace('"emulated.py', f'"{EXAMPLE / "emulated.py"}')
        rig.write_text(text.replace('controller = "controller"', f'controller = "{name}"'))
        rigs = (None, str(EXAMPLE / "emulated.toml"), str(rig))
        runs = [bp.run(scenario, on=each) for each in rigs]
        errors = [
            f"{each.metrics['tracking_error_percent']:.1f} %"
            if each.outcome == "finished"
            else each.outcome
            for each in runs
        ]
        steps = step_times(folder)
        size = size_of(build_firmware(EMULATED.FIRMWARE, folder))
    return Computed(law, errors, size, (float(np.median(steps)), max(steps)))


def main() -> None:
    """Run everything, and write the page."""
    rows = [carried_out(row) for row in ROWS]
    page = filled(
        "firmware",
        heading=FAULT_HEADINGS,
        rows=map(row_cells, rows),
        good=sum(row.good for row in rows),
        number=len(rows),
        plain=size_of(build_firmware(EMULATED.FIRMWARE)),
        laws=[computed(law) for law in LAWS],
        flash=FLASH_BYTES,
        ram=RAM_BYTES,
    )
    write(HERE / "firmware.md", page)


if __name__ == "__main__":
    main()
