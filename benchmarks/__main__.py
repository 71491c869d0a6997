"""Prints every figure of speed that has a goal, and makes docs/performance.md.

uv run python -m benchmarks
uv run python -m benchmarks --doc docs/performance.md --before ../before
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from itertools import chain
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks import physics_step
from benchmarks.figures import Figure, figures
from benchmarks.truths import RUNS
from twin.markdown import table
from twin.writing import write_whole

DEPENDS = """\
Every figure but the notes is a ratio of two times that were measured in turn in one run, the least
of several rounds, so that it holds on other machines as far as their processors are alike. It
depends on:

- **load.** Other work on the machine slows both sides, but not alike: a rig alone works from the
  cache, `import numpy` reads files. Measure on a quiet machine; the load then is told below.
- **byte code.** Commands are measured as from their second call on. Where nothing may be written
  beside the sources (`PYTHONDONTWRITEBYTECODE`, a read-only disk), every start compiles what it
  imports, which takes several times as long.
- **the versions of mujoco and numpy**, told below.

- **the motion.** Physics of a plate and a ball at rest takes little more than half as long as that
  of a ball that rolls, control takes the same. The closed loop's goal is about `sine`, which moves
  at once; `circle`, with a predictor besides, starts softly and is taken over 5 s.

`uv run python -m benchmarks.closed_loop --parts` tells what each part of the closed loop costs. Two
physics steps whose sensors are brought up to date take about half as long again as two bare ones,
for what is calculated between them has driven their numbers out of the processor's nearest cache;
the rest is some hundred calls of numpy on two to eight numbers each.

Of `run circle` more than half is the two loops, side by side in two processes, so that it takes
some two thirds of its processor time by the clock. The rest is nearly all imports, of matplotlib
above all. On Linux the second process is a fork and imports nothing again but matplotlib; other
systems pay for the imports twice.

Runs per hour of an earlier commit need a checkout of it; without one that row is missing:

    git worktree add ../before 95b7a20 && (cd ../before && uv sync)
    uv run python -m benchmarks --doc docs/performance.md --before ../before

Further measurements, each a module: `benchmarks.throughput` (a study beside bare physics, one core
and all), `benchmarks.realtime` (the 2 ms loop by the clock).
"""
STEP = """\
Studies simulate the mechanism in steps of 2 ms, single runs in steps of 1 ms. What either gets
wrong is told as the difference to a step of 0.25 ms with the same noise: of the ball's path over
some seconds rms and largest amount, and by how much the rms tracking error changes; of numbers the
difference in their unit. A scenario or study that says `plant.step` keeps it. These keep their own
step, too, 1 ms unless they say another:

- single runs (`run`, `compare`, `view`), because they may be wired to emulated drives, which look
  at the plant once a step: the row "circle over the emulated wire";
- the exact equations, which follow play worse: the row that begins with them;
- wheels harder than 500 kN/m or damped more than 0.3 of critical: the damping of their contact is
  explicit and runs away in the row "wheels damped twice critical";
- control periods that are no multiple of 2 ms.

Play and a ball that sticks and slips are sensitive to anything; their paths differ at any step.
`uv run python -m benchmarks.physics_step --thesis` adds the tracking errors of Tables 9.2 to 9.9.
"""
QUICK = " One round of what takes seconds: a quick look, no figures to rely on."
HEADINGS = ("figure", "found", "goal", "reached", "")


def cells(figure: Figure) -> tuple[str, ...]:
    """A row of the table."""
    return figure.what, f"{figure.found:.2f}", figure.bound, figure.reached, figure.note


def show(found: Iterator[Figure]) -> list[Figure]:
    """Print a line as each is found, then all as a table."""
    console, kept = Console(), []
    for figure in found:
        console.print(f"{figure.what}: {figure.found:.2f}", style="dim", highlight=False)
        kept.append(figure)
    printed = Table(*HEADINGS)
    for figure in kept:
        printed.add_row(*cells(figure))
    console.print(printed)
    return kept


def machine(load: float, *, quick: bool) -> str:
    """What it was measured on, in a sentence or two."""
    libraries = ", ".join(f"{name} {version(name)}" for name in ("mujoco", "numpy", "scipy"))
    return (
        f"Measured on {os.cpu_count()} cores ({platform.machine()}, {platform.system()}), "
        f"Python {platform.python_version()}, {libraries}; load when it began {load:.1f}."
        f"{QUICK if quick else ''}\n"
    )


def page(found: Sequence[Figure], about: str, deviations: Sequence[Sequence[str]]) -> str:
    """docs/performance.md."""
    return "\n".join(
        (
            "# How fast it is\n",
            "Made by `uv run python docs/regenerate.py performance`.\n",
            table(HEADINGS, map(cells, found), words=(0, -1)),
            about,
            DEPENDS,
            "## What a physics step of 2 ms gets wrong\n",
            STEP,
            table(("", "at 0.25 ms", "1 ms off by", "2 ms off by"), deviations),
        )
    )


def parser() -> argparse.ArgumentParser:
    """What may be asked."""
    made = argparse.ArgumentParser("benchmarks", description=__doc__.partition("\n")[0])
    made.add_argument("--doc", type=Path, help="write the page with all figures here")
    made.add_argument("--before", type=Path, help="a checkout of commit 95b7a20 with its .venv")
    made.add_argument("--quick", action="store_true", help="one round of what takes seconds")
    return made


def main() -> None:
    """Measure and tell."""
    options = parser().parse_args()
    begin, load = time.monotonic(), os.getloadavg()[0]
    found = show(figures(options.before, quick=options.quick))
    if options.doc is not None:
        if options.quick:
            deviations = list(physics_step.paths(1.0, tuple(RUNS)[:3]))
        else:
            deviations = list(chain(physics_step.paths(), physics_step.numbers()))
        text = page(found, machine(load, quick=options.quick), deviations)
        write_whole(options.doc, lambda path: path.write_text(text.strip() + "\n", "utf-8"))
    print(f"{time.monotonic() - begin:.0f} s")


if __name__ == "__main__":
    main()
