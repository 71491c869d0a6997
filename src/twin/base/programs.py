"""Programs that must be installed: compilers and what belongs to them."""

from __future__ import annotations

import atexit
import shutil
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from twin.base.errors import TwinError

C_COMPILERS = ("cc", "gcc", "clang")
"""C compilers, the preferred one first."""


def find_c_compiler() -> str | None:
    """The path of a C compiler of this machine; None if there is none."""
    return next((path for each in C_COMPILERS if (path := shutil.which(each))), None)


def find_program(
    program: str, packages: Mapping[str, str], needed_by: str, error: type[TwinError]
) -> str:
    """The path of a program that must be installed.

    Args:
        program: The program.
        packages: The packages of Debian that have a program, by its name.
        needed_by: Key or part that needs it, for the message.
        error: Kind of the error.

    Raises:
        TwinError: Of that kind, if it is not installed: which packages have it.
    """
    found = shutil.which(program)
    if found is None:
        raise error(
            f"{needed_by}: needs {program}, which is not installed "
            f"(packages of Debian: {packages[program]})"
        )
    return found


@cache
def build_folder() -> Path:
    """The folder of the programs that this process compiles, deleted when the process ends."""
    folder = TemporaryDirectory(prefix="ballplate-programs-", ignore_cleanup_errors=True)
    atexit.register(folder.cleanup)  # without it Python warns that nobody did
    return Path(folder.name)


def find_error_line(message: str) -> str:
    """The line of a compiler's message with its first error, else its first line."""
    lines = message.strip().splitlines()
    return next((line for line in lines if "error" in line), (lines or ["no message"])[0])
