"""A controller as a program for an emulated processor or this computer, and how it is run."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, NamedTuple

from twin.base import programs
from twin.base.errors import ScenarioError, TwinError, plural
from twin.base.parts import extra
from twin.board.footprint import ARM_FLAGS

if TYPE_CHECKING:
    from twin.board.control import Control

CONTROLLER_NAME = "controller"
"""What the names of files and functions begin with."""
INSTRUCTION_SHIFT = 7
"""An instruction takes 2^INSTRUCTION_SHIFT ns of QEMU's time, and a tick of its SysTick 40 ns. From
7 on an instruction takes at least three ticks, so that ticks, counted to within one, give the exact
number of instructions."""
EMULATOR = "qemu-system-arm"
ELF_ARM = b"\x28\0"
"""What an ELF file for an ARM processor has at byte 18."""
COMPILER_PACKAGES = {
    "arm-none-eabi-gcc": "gcc-arm-none-eabi libnewlib-arm-none-eabi",
    EMULATOR: "qemu-system-arm",
    "gcc": "gcc",
}
"""The packages of Debian that have a program."""
COMMON_FLAGS = ("-std=c99", "-O2")
"""Flags of all compilers: no contracted products, no ``-ffast-math``."""


class Target(NamedTuple):
    """What a program can be compiled for.

    Attributes:
        compiler: The compiler.
        flags: Its flags.
        size: The program that states sizes.
    """

    compiler: str
    flags: tuple[str, ...]
    size: str


TARGETS = {
    "cortex-m4": Target(
        "arm-none-eabi-gcc",
        (*ARM_FLAGS, "-nostartfiles", "-ffunction-sections", "-Wl,--gc-sections"),
        "arm-none-eabi-size",
    ),
    "host": Target("gcc", (), "size"),
}
"""Targets by the names that ``board.program`` gives them."""


def check_program(program: str, called: str) -> None:
    """Make sure that there is a target or file of a name.

    Args:
        program: The name.
        called: What a message calls it: a key or an option.

    Raises:
        ScenarioError: If there is neither.
    """
    if program not in TARGETS and not Path(program).is_file():
        raise ScenarioError(
            f"{called}: must be {', '.join(TARGETS)} or the file of a program, there is "
            f"no '{program}'"
        )


class Size(NamedTuple):
    """Memory of a program.

    Attributes:
        flash_bytes: Code, constants and the first values of variables.
        ram_bytes: Variables, without the stack.
    """

    flash_bytes: int
    ram_bytes: int


def find_program(program: str) -> str:
    """The path of a program that must be installed.

    Raises:
        ScenarioError: If it is not: which packages of Debian have it.
    """
    return programs.find_program(program, COMPILER_PACKAGES, "board.program", ScenarioError)


def command_of(program: Path) -> list[str]:
    """What runs a compiled program: the emulator for an ``.elf``, else the program itself.

    Raises:
        ScenarioError: If the file is none for the emulator, or that is not installed.
    """
    if program.suffix != ".elf":
        return [str(program.resolve())]
    with program.open("rb") as file:
        head = file.read(20)
    if head[:4] != b"\x7fELF" or head[18:20] != ELF_ARM:
        raise ScenarioError(f"board.program: {program} is no ELF file for an ARM processor")
    return [
        find_program(EMULATOR),
        *("-machine", "mps2-an386", "-icount", f"shift={INSTRUCTION_SHIFT}"),
        *("-display", "none", "-monitor", "none", "-serial", "none"),
        *("-semihosting-config", "enable=on,target=native"),
        *("-kernel", str(program)),
    ]


def compile_controller(control: Control, target: str, real: str) -> Path:
    """The program of a controller, compiled once in the life of this process.

    Args:
        control: The controller.
        target: One of ``TARGETS``.
        real: ``double`` or ``float``.

    Raises:
        TwinError: If the controller has no form in C, the compiler or CasADi is not installed, or
            the program does not fit into the memory.
    """
    find_program(TARGETS[target].compiler)
    with extra("casadi", "board.program"):
        from twin.board.source import sources  # noqa: PLC0415  heavy: loaded when needed
    texts = sources(CONTROLLER_NAME, control, real)
    return _compile(tuple(sorted(texts.items())), target)


def build_command(folder: str, name: str) -> str:
    """The command that makes the program of an exported controller, in its folder.

    Args:
        folder: The folder in it with the files of the board.
        name: What the names of the controller's files begin with.
    """
    about = TARGETS["cortex-m4"]
    files = f"-I. -T{folder}/board.ld {folder}/board.c {name}.c -o {name}.elf -lm"
    return " ".join((about.compiler, *COMMON_FLAGS, *about.flags, files))


def size_of(program: Path, target: str) -> Size:
    """The memory that a program, compiled for one of ``TARGETS``, needs."""
    listed = subprocess.run(
        [TARGETS[target].size, str(program)], capture_output=True, text=True, check=True
    )
    text, data, bss = map(int, listed.stdout.splitlines()[1].split()[:3])
    return Size(text + data, data + bss)


@cache
def _compile(texts: tuple[tuple[str, str], ...], target: str) -> Path:
    about, own = TARGETS[target], Path(mkdtemp(dir=programs.build_folder()))
    _write(dict(texts), own)
    program, script = own / "board", list[str]()
    if target == "cortex-m4":
        program, script = own / "board.elf", ["-Tboard.ld"]
    files = [*script, "board.c", f"{CONTROLLER_NAME}.c", "-o", program.name, "-lm"]
    done = subprocess.run(
        [about.compiler, *COMMON_FLAGS, *about.flags, *files],
        cwd=own,
        env=os.environ | {"LC_ALL": "C"},  # messages as they are read here
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise TwinError(f"board.program: {about.compiler}: {_why(done.stderr)}")
    return program


def _write(texts: Mapping[str, str], folder: Path) -> None:
    for name, text in texts.items():
        (folder / Path(name).name).write_text(text, encoding="utf-8")


def _why(text: str) -> str:
    """The line of a compiler's message with the reason, without the paths before it."""
    if over := re.search(r"region `(\w+)' overflowed by (\d+) bytes", text):
        return (
            f"needs {plural(int(over[2]), 'byte')} more than the {over[1]} of the emulated board "
            "has; a reference "
            "without a closed form is a table, which a shorter duration makes smaller"
        )
    return programs.find_error_line(text).rpartition("error: ")[2].strip()
