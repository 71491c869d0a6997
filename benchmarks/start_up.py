"""Processor time of whole commands, from the shell to the end, in times of ``import numpy``.

Commands and the import take turns, each in a fresh process with byte code kept, as a user has it
after the first call; the least of all rounds.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

CALL = "from twin.cli import main; main()"
QUICK = {
    "--help": ("--help",),
    "list": ("list",),
    "run --help": ("run", "--help"),
    "a misspelt scenario": ("run", "cirle"),
}
"""Commands that are to answer in the time of the import."""
OURS = ("PYTHONDONTWRITEBYTECODE", "OPENBLAS_NUM_THREADS")
"""What a user's own environment does not say."""
WHOLE = {"run circle": ("run", "circle", "--out", ".")}
"""A run with all its files."""


def spent(*command: str, folder: str) -> float:
    """Processor seconds, user and system, of a Python process."""
    environment = {name: value for name, value in os.environ.items() if name not in OURS}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        (sys.executable, *command), cwd=folder, env=environment, capture_output=True, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def ratios(commands: Mapping[str, tuple[str, ...]], rounds: int) -> tuple[float, dict[str, float]]:
    """Seconds of ``import numpy``, and how many times that each command takes."""
    least = dict.fromkeys(("", *commands), float("inf"))
    with TemporaryDirectory() as folder:
        for _ in range(rounds):
            least[""] = min(least[""], spent("-c", "import numpy", folder=folder))
            for name, arguments in commands.items():
                taken = spent("-c", CALL, *arguments, folder=folder)
                least[name] = min(least[name], taken)
        if "run circle" in commands and not list(Path(folder).glob("**/run.parquet")):
            raise RuntimeError("run circle wrote no record")
    numpy = least.pop("")
    return numpy, {name: taken / numpy for name, taken in least.items()}
