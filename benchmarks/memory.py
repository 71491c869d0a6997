"""How the memory of many runs grows, in MiB for a thousand more of them.

uv run python -m benchmarks.memory

A sweep of 100 and one of 1,000 points, a study of 1,000 and one of 10,000 runs: of each the largest
memory of a process of its own. What they keep of a run is a row of indicators; a motion of 2 s has
15 MiB in a thousand runs for each column of two axes.
"""

from __future__ import annotations

import os
import subprocess
import sys

from twin.base.page import markdown

SWEPT = """
import sys
import ballplate

seeds, fixed = [*range(int(sys.argv[1]))], ["plant.kind=lagrange", "duration=2.0", "baseline=false"]
ballplate.sweep("circle", {"seed": seeds}, settings=[*fixed, "metrics.start=1.0"], processes=1)
"""
STUDIED = """
import sys
import ballplate

fixed = ("plant.kind=lagrange", "duration=2.0", "metrics.start=1.0", "baseline=false")
study = {
    "title": "memory", "scenario": "circle", "set": fixed, "method": "montecarlo",
    "parameters": {"plant.friction.rolling_mm": {"uniform": (0.1, 0.3)}},
}
ballplate.study(study, samples=int(sys.argv[1]), processes=1, engine="c")
"""
HELD = """
import resource, subprocess, sys

subprocess.run((sys.executable, "-c", *sys.argv[1:]), check=True)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024)
"""
"""Largest memory in MiB of a program and its words. A small process starts it: on Linux the largest
memory of a process begins with that of the one that started it."""
ROWS = (("sweep", SWEPT, 100, 1_000), ("study with engine = c", STUDIED, 1_000, 10_000))
"""What runs, by which program, and how many runs twice."""


def peak_mib(program: str, runs: int) -> float:
    """Largest memory of a process with so many runs, in MiB."""
    done = subprocess.run(
        (sys.executable, "-c", HELD, program, str(runs)),
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        check=True,
        text=True,
    )
    return float(done.stdout.split()[-1])


def growth(program: str, few: int, many: int) -> tuple[float, float, float]:
    """Largest memory in MiB with few and with many runs, and by how much it grows per 1,000."""
    small, large = (peak_mib(program, runs) for runs in (few, many))
    return small, large, 1000 * (large - small) / (many - few)


def main() -> None:
    """Print what each costs."""
    found = []
    for what, program, few, many in ROWS:
        small, large, more = growth(program, few, many)
        found.append((what, f"{few}: {small:.0f}", f"{many}: {large:.0f}", f"{more:.1f}"))
    print(markdown(("runs", "MiB of few", "MiB of many", "MiB per 1,000 runs"), found))


if __name__ == "__main__":
    main()
