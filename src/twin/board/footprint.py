"""Flash and stack that a controller in C needs, as a compiler states them."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

ARM_FLAGS = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")
"""For a Cortex-M4F, which has a floating-point unit for ``float`` only."""
TOOLCHAINS = (
    ("arm-none-eabi-gcc", "arm-none-eabi-size", ARM_FLAGS, "a Cortex-M4F"),
    ("gcc", "size", (), "this computer"),
)
"""Compiler, its size program, its flags and the processor; the first that is installed is used."""
SIZE_FLAGS = ("-std=c99", "-Os", "-fstack-usage", "-c")


class Footprint(NamedTuple):
    """Memory of a controller.

    Attributes:
        processor: The processor that it is compiled for.
        flash_bytes: Code and constants, without the functions of ``math.h``.
        stack_bytes: Stack at most: the sum of all its functions, none of which calls itself.
    """

    processor: str
    flash_bytes: int
    stack_bytes: int


def measure_footprint(name: str, texts: Mapping[str, str]) -> Footprint | None:
    """The memory of a controller; None if there is no compiler that states it.

    Args:
        name: Name of its C file without the ending.
        texts: The C source by the names of its files.
    """
    for compiler, size, flags, processor in TOOLCHAINS:
        if not (shutil.which(compiler) and shutil.which(size)):
            continue
        with tempfile.TemporaryDirectory(prefix="ballplate-") as folder:
            for file in (f"{name}.c", f"{name}.h"):
                Path(folder, file).write_text(texts[file], encoding="utf-8")
            try:
                _run(folder, compiler, *SIZE_FLAGS, *flags, f"{name}.c")
                sizes = _run(folder, size, f"{name}.o").splitlines()[1].split()
                stack = Path(folder, f"{name}.su").read_text(encoding="utf-8")
            except (subprocess.CalledProcessError, OSError, IndexError):
                continue
            used = map(int, re.findall(r"\t(\d+)\t", stack))
            return Footprint(processor, int(sizes[0]) + int(sizes[1]), sum(used))
    return None


def _run(folder: str, *command: str) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout
