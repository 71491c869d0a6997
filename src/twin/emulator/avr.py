"""The real firmware of a board with an ATmega328P, executed by simavr, and the plate it moves.

Time is virtual: the chip executes for as long as it is asked, then waits. Its serial line is a
pseudo-terminal, so that a host opens it as a serial port; how many bytes cross it in a time is part
of the conversation, so that every run is the same. Its servo pulses are measured at the pins.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import NamedTuple
from weakref import finalize

import numpy as np

from controllers.arrays import Array
from twin.base.errors import RigError, plural
from twin.base.programs import build_folder, find_error_line, find_program
from twin.emulator.can_bus import check_pseudo_terminals
from twin.hal.interface import Touch
from twin.run.assemble import build_devices
from twin.run.plants import build_plant
from twin.scenario.schema import Scenario

CLOCK_HZ = 16_000_000
"""Frequency that the firmware takes its clock to have."""
AVR_FLAGS = ("-mmcu=atmega328p", f"-DF_CPU={CLOCK_HZ}UL", "-std=gnu99", "-Os", "-fstack-usage")
"""Flags of avr-gcc for the firmware."""
PACKAGES = {"avr-gcc": "gcc-avr avr-libc", "avr-size": "binutils-avr", "cc": "gcc libc6-dev"}
"""The packages of Debian that have a program."""
SIMAVR_HEADERS = Path("/usr/include/simavr")
SIMAVR_PACKAGE = "libsimavr-dev"
FLASH_BYTES, RAM_BYTES = 32768, 2048
"""Memory of an ATmega328P."""
LIBRARY_STACK_BYTES = 64
"""Stack for functions of avr-libc; no compiler states it."""
TICK_S = 0.002
"""Time in s that chip and plant take turns in."""


_TOO_LARGE_TEXT = "emulated board: the firmware does not fit into an ATmega328P"


def missing_programs() -> list[str]:
    """What of compilers and simavr is not installed; empty if the board can be emulated."""
    found = [each for each in PACKAGES if shutil.which(each) is None]
    return found if SIMAVR_HEADERS.is_dir() else [*found, SIMAVR_PACKAGE]


class Size(NamedTuple):
    """Memory of a firmware.

    Attributes:
        flash_bytes: Code, constants and the first values of variables.
        ram_bytes: Variables and constants, without the stack.
        stack_bytes: Stack at most: the sum of all its functions, none of which calls itself.
    """

    flash_bytes: int
    ram_bytes: int
    stack_bytes: int


@cache
def build_firmware(folder: Path, controller: Path | None = None, defines: str = "") -> Path:
    """Compile a firmware, once in the life of this process.

    Args:
        folder: The folder with ``firmware.c``.
        controller: The folder with ``controller.c``, of ``ballplate export --real float``, for a
            board that computes.
        defines: Further definitions, separated by spaces: ``NEUTRAL_US_PHI=1490``.

    Returns:
        The ELF file.

    Raises:
        RigError: If a file or a compiler is missing, or the firmware does not fit into the chip.
    """
    sources, flags = [folder / "firmware.c"], [f"-D{each}" for each in defines.split()]
    if controller is not None:
        sources.append(controller / "controller.c")
        flags += ["-DBOARD_COMPUTES=1", f"-I{controller}"]
    own = Path(mkdtemp(dir=build_folder()))
    program = own / "firmware.elf"
    _compile("avr-gcc", [*AVR_FLAGS, *flags], sources, ["-lm"], program)
    size = size_of(program)
    if (left := RAM_BYTES - size.ram_bytes) < size.stack_bytes:
        raise RigError(
            f"{_TOO_LARGE_TEXT}: its RAM has {plural(left, 'byte')} left for a stack of up to "
            f"{size.stack_bytes}"
        )
    return program


@cache
def build_emulator() -> Path:
    """Compile the program around simavr, once in the life of this process.

    Raises:
        RigError: If a compiler or simavr is missing.
    """
    program = Path(mkdtemp(dir=build_folder())) / "avr"
    flags = ["-O2", f"-I{SIMAVR_HEADERS}"]
    _compile("cc", flags, [Path(__file__).with_suffix(".c")], ["-lsimavr", "-lm"], program)
    return program


def size_of(firmware: Path) -> Size:
    """The memory that a firmware of ``build_firmware`` needs.

    Raises:
        RigError: If avr-size is missing, or cannot read the file.
    """
    done = subprocess.run(
        [_find("avr-size"), str(firmware)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        why = (done.stderr.splitlines() or ["no message"])[0]
        raise RigError(f"emulated board: {why}")
    text, data, bss = map(int, done.stdout.splitlines()[1].split()[:3])
    functions = [
        int(line.split("\t")[1])
        for file in firmware.parent.glob("*.su")
        for line in file.read_text(encoding="utf-8").splitlines()
    ]
    return Size(text + data, data + bss, sum(functions) + LIBRARY_STACK_BYTES)


def _find(program: str) -> str:
    """The path of a program that must be installed."""
    return find_program(program, PACKAGES, "emulated board", RigError)


def _compile(
    compiler: str,
    flags: Sequence[str],
    sources: Sequence[Path],
    libraries: Sequence[str],
    program: Path,
) -> None:
    path = _find(compiler)
    if compiler == "cc" and not SIMAVR_HEADERS.is_dir():
        raise RigError(
            f"emulated board: needs simavr, which is not installed (packages of Debian: "
            f"{SIMAVR_PACKAGE})"
        )
    for each in sources:
        if not each.is_file():
            raise RigError(f"emulated board: there is no {each}")
    files = [str(each.resolve()) for each in sources]
    done = subprocess.run(
        [path, *flags, *files, "-o", str(program), *libraries],
        cwd=program.parent,  # where the use of the stack is written
        env=os.environ | {"LC_ALL": "C"},  # messages as they are read here
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode and re.search(r"is too large|not within region|overflowed", done.stderr):
        raise RigError(
            f"{_TOO_LARGE_TEXT}; large are an ekf, and the table of a reference "
            "without a closed form"
        )
    if done.returncode:
        raise RigError(f"emulated board: {compiler}: {find_error_line(done.stderr)}")


class Chip:
    """A chip that executes a firmware, in lockstep.

    Attributes:
        port: Path of its serial line.

    Args:
        firmware: Its ELF file.
        clock_error: Share by which its clock is too fast.

    Raises:
        RigError: If simavr cannot be compiled or started.
    """

    def __init__(self, firmware: Path, clock_error: float = 0.0) -> None:
        check_pseudo_terminals()
        import tty  # noqa: PLC0415  POSIX only

        program = build_emulator()
        clock = f"{CLOCK_HZ * (1 + clock_error):.0f}"
        with ExitStack() as failed:
            try:
                ours, theirs = os.openpty()
                failed.callback(os.close, theirs)
                with ExitStack() as passed:
                    passed.callback(os.close, ours)
                    tty.setraw(theirs)
                    self.port = os.ttyname(theirs)
                    self._process = subprocess.Popen(
                        [program, firmware, clock, str(ours)],
                        pass_fds=[ours],
                        stdin=subprocess.PIPE,
                        stdout=subprocess.PIPE,
                        stderr=subprocess.PIPE,
                        text=True,
                    )
            except OSError as error:
                raise RigError(f"emulated board: cannot be started: {error}") from error
            failed.pop_all()
        self.close = finalize(self, _end, self._process, theirs)
        """Ends it; may be called again."""

    def run(self, seconds: float, written: int) -> tuple[int, list[tuple[int, float]]]:
        """Let it execute for a time.

        Args:
            seconds: The time.
            written: Number of bytes that the host has written to the port since the last time.

        Returns:
            Number of bytes that are there for the host, and the servo pulses that have ended: axis
            (0 for phi) and width in s.

        Raises:
            RigError: If its process has ended.
        """
        sent, *pulses = self.tell(f"run {1e6 * seconds:.3f} {written}").split()
        pairs = [each.split(":") for each in pulses]
        return int(sent), [(int(axis), 1e-6 * float(width)) for axis, width in pairs]

    def tell(self, command: str) -> str:
        """Give a command of ``avr.c``; return its answer.

        Raises:
            RigError: If its process has ended.
        """
        pipe, answers = self._process.stdin, self._process.stdout
        assert pipe is not None
        assert answers is not None
        try:
            pipe.write(command + "\n")
            pipe.flush()
        except OSError:
            answer = ""
        else:
            answer = answers.readline()
        if not answer:
            complaints = self._process.stderr
            why = complaints.readline().strip() if complaints else ""
            raise RigError(f"emulated board: its process has ended{why and ': '}{why}")
        return answer


def _end(process: subprocess.Popen[str], port: int) -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout, process.stderr):
        if pipe is not None:
            try:
                pipe.close()
            except OSError:  # what was still to be written goes nowhere
                continue
    os.close(port)


class PulsedPlate:
    """A scenario's plate, ball and camera, with servos that go to where their pulses say.

    A servo that gets no pulses keeps its last goal.

    Args:
        scenario: Of plate, ball and camera.
        neutral: Width in s of the pulse at which the plate is level.
        per_rad: Change of the width per plate angle, s/rad.

    Raises:
        RigError: If the plant's step does not divide ``TICK_S``.
        ModelError: If the mechanism cannot be used.
    """

    def __init__(self, scenario: Scenario, neutral: float, per_rad: float) -> None:
        step = scenario.plant.step
        if round(TICK_S / step) < 1 or abs(round(TICK_S / step) * step - TICK_S) > 1e-9 * TICK_S:
            raise RigError(
                f"emulated board: plant.step: must divide the {TICK_S:g} s in which chip and plate "
                f"take turns, got {step:g}"
            )
        plant, self._transmission = build_plant([scenario])
        self.devices = build_devices([scenario], plant, period=TICK_S)
        self._neutral, self._per_rad = neutral, per_rad
        self._goal: Array = np.zeros((1, 2))
        self._reached: Array = np.zeros((1, 2))

    def pulse(self, axis: int, width: float) -> None:
        """Take in a pulse of a width in s for an axis, 0 for phi."""
        self._goal[0, axis] = (width - self._neutral) / self._per_rad

    def advance(self) -> None:
        """Let ``TICK_S`` pass."""
        motor = self._transmission.motor
        turn = motor(self._goal) - motor(self._reached)
        self._reached = self._goal.copy()
        self.devices.command(turn / TICK_S)
        self.devices.wait()

    def camera(self) -> Touch:
        """The newest picture that has arrived."""
        return self.devices.read()

    @property
    def state(self) -> Array:
        """The true state of (5.5), shape (8,)."""
        return self.devices.state[0]
