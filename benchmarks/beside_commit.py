"""Processor time here compared with that of an earlier commit, each figure with its goal.

    git worktree add ../old 2a000bf6 && (cd ../old && uv sync)
    uv run python -m benchmarks.beside_commit ../old
    uv run python -m benchmarks.beside_commit ../old --only command --only fixed

Both take turns, each in a process of its own with its own environment and one thread of OpenBLAS;
the least of all rounds counts. Either simulates what its own scenario of that name says.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import click

from twin.base.page import markdown

COMMIT = "2a000bf6"
PERIOD_S = 0.002
BATCH = """
import sys, time
from mujoco.batch import Batch
from twin.run.loop import simulate
from twin.scenario import load

PERIOD_S = 0.002
name, rigs, seconds, *settings = sys.argv[1:]
seconds = float(seconds)
fixed = [f"duration={seconds}", f"metrics.start={seconds / 2}", "baseline=false"]
batch = [load(name, [*settings, *fixed, f"seed={seed}"]) for seed in range(int(rigs))]
# what a first run loads and designs is no cost of a period
simulate([load(name, [*settings, "duration=0.1", "metrics.start=0", "baseline=false"])])
"""
SIMULATED = (
    BATCH
    + """
begin = time.process_time()
simulate(batch)
print(1e6 * (time.process_time() - begin) * PERIOD_S / seconds)
"""
)
"""Of one control period of all rigs, in us. Read by the Python of either checkout, as all here."""
FIXED = (
    BATCH
    + """
steps, original = [], Batch.step

def step(*given):
    begin = time.process_time()
    original(*given)
    steps.append((begin, time.process_time()))

Batch.step = step
simulate(batch)
physics = sum(end - begin for begin, end in steps)
print(1e6 * (steps[-1][1] - steps[0][0] - physics) / len(steps))
"""
)
"""The same without the engine's own steps, set-up and evaluation."""
SWEPT = """
import sys, time
import ballplate
name, rigs, seconds, *settings = sys.argv[1:]
settings += [f"duration={seconds}", f"metrics.start={float(seconds) / 2}", "baseline=false"]
ballplate.sweep(name, {"seed": [0]}, settings=settings, processes=1)
begin = time.process_time()
ballplate.sweep(name, {"seed": [*range(int(rigs))]}, settings=settings, processes=1)
print(1e6 * (time.process_time() - begin) * 0.002 / float(seconds))
"""
"""As ``SIMULATED``, of a sweep over seeds on one process."""
STUDIED = (
    BATCH
    + """
from twin.study.work import carry_out, ScenarioRuns
try:
    from twin.study.compiled import carry_out_compiled as carry_out
except ImportError:
    pass
runs = ScenarioRuns(batch)
jobs = runs.jobs(runs.tasks)
carry_out(jobs[:1])
begin = time.process_time()
carry_out(jobs)
print(1e6 * (time.process_time() - begin) * PERIOD_S / seconds)
"""
)
"""As ``SIMULATED``, by the fastest engine of a study: compiled, where there is one."""
COMMANDED = """
import sys, time
import numpy as np
from twin.run.assemble import assemble
from twin.scenario import load

name, _, seconds, *settings = sys.argv[1:]
rig, controller = assemble(load(name, settings))
times = []
with rig:
    measurement = rig.read()
    controller.start(measurement)
    rig.start()
    for _ in range(round((float(seconds) + 1) / rig.period)):
        begin = time.thread_time_ns()
        step = controller.command(measurement)
        passed = time.thread_time_ns() - begin
        rate = rig.write(step.rate)
        begin = time.thread_time_ns()
        controller.applied(rate)
        times.append(passed + time.thread_time_ns() - begin)
        rig.wait()
        measurement = rig.read()
print(np.median(times[round(1 / rig.period) :]) / 1e3)
"""
"""Median of one rig's command after the first second, observer and law, in us."""
SHELL = """
import resource, subprocess, sys, tempfile

name, _, seconds, command, *given = sys.argv[1:]
given += ["--set", f"duration={seconds}", "--set", f"metrics.start={float(seconds) / 2}"]
with tempfile.TemporaryDirectory() as folder:
    call = [sys.executable, "-c", "from twin.cli import main; main()", command, name, *given]
    subprocess.run([*call, "--out", folder + "/out"], capture_output=True, check=True)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
"""
RAN = SHELL + "print(used.ru_utime + used.ru_stime)"
"""Processor seconds of a command from the shell to its last file; the settings are its words."""
HELD = SHELL + "print(used.ru_maxrss / 1024)"
"""Memory in MiB of the largest of its processes."""
STARTED = """
import time
begin = time.process_time()
import twin.study.work, twin.whatif.futures
print(time.process_time() - begin)
"""
"""Processor seconds of the imports of a study and of whatif."""


class Row(NamedTuple):
    """A figure that is compared.

    Attributes:
        name: What ``--only`` calls it.
        what: What is measured.
        unit: Its unit.
        program: What prints it, given scenario, rigs, seconds and settings.
        rigs: How many.
        case: Scenario and settings, or command and words.
        goal: Largest ratio of here to the earlier commit; None for none.
        seconds: Simulated time.
    """

    name: str
    what: str
    unit: str
    program: str
    rigs: int
    case: tuple[str, ...]
    goal: float | None = None
    seconds: float = 3.0

    @property
    def figure(self) -> str:
        """The ratio in words."""
        return f"{self.what}, relative to commit {COMMIT}"


MECHANISM, EXACT = "plant.kind=mujoco", "plant.kind=lagrange"
CIRCLE, KALMAN = ("circle", MECHANISM), ("cure", EXACT, "observer.kind=friction_kalman")
LAWS = "afl", "afl_integral", "backstepping", "feedforward", "lqr", "pid"
EXPLAINED = ("circle", "explain", "--processes", "1")
COMPARED = ("circle", "compare", "--processes", "1", "--vary", f"controller.kind={list(LAWS)}")
ROWS = (
    Row("fixed", "16 rigs, afl, mechanism, without physics", "us", FIXED, 16, ("circle",), 0.5),
    Row("point", "1 rig of a study, afl, mechanism", "us", SIMULATED, 1, ("circle",), 0.2),
    Row("batch", "16 rigs, afl, mechanism", "us", SIMULATED, 16, ("circle",)),
    Row("batch", "128 rigs, cure, exact equations", "us", SIMULATED, 128, ("cure", EXACT)),
    Row("batch", "128 rigs, cure, mechanism", "us", SIMULATED, 128, ("cure", MECHANISM)),
    Row("kalman", "128 rigs, friction_kalman, exact equations", "us", SIMULATED, 128, KALMAN, 0.6),
    Row("batch", "128 rigs, afl, exact equations", "us", SIMULATED, 128, ("circle", EXACT)),
    Row(
        "compiled",
        "128 runs of a study in C, afl, exact equations",
        "us",
        STUDIED,
        128,
        ("circle", EXACT),
        0.125,
        12.0,
    ),
    Row("sweep", "sweep of 128 points, afl, mechanism", "us", SWEPT, 128, CIRCLE, 0.125),
    Row("explain", "explain circle", "s", RAN, 1, EXPLAINED, 0.5, 8.0),
    Row("compare", "compare of six laws", "s", RAN, 6, COMPARED, 0.6, 8.0),
    Row("command", "one command of the cure", "us", COMMANDED, 1, ("cure",), 0.6),
    Row("start", "imports of a study and of whatif", "s", STARTED, 1, ("circle",)),
    Row("run", "run circle from the shell", "s", RAN, 1, ("circle", "run"), 0.7, 25.0),
    Row("memory", "memory of run circle", "MiB", HELD, 1, ("circle", "run"), 0.76, 25.0),
)
"""All that is compared; a period of all rigs where nothing else is stated."""
SMALL_GROUPS, LARGE_GROUP = (2, 5, 9, 15), 16
SMALL_GROUP_GOAL = 1.3
"""Largest cost of a period of a small group, in times of that of ``LARGE_GROUP`` rigs."""


def measure(checkout: Path, row: Row) -> float:
    """What a row's program prints in a checkout."""
    python = checkout / ".venv" / "bin" / "python"
    name, *settings = row.case
    done = subprocess.run(
        (python, "-c", row.program, name, str(row.rigs), str(row.seconds), *settings),
        cwd=checkout,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        check=True,
        text=True,
    )
    return float(done.stdout)


def compared(old: Path, only: tuple[str, ...], rounds: int) -> Iterator[tuple[Row, float, float]]:
    """Every figure at the earlier commit and here, as it is found."""
    here = Path(sys.prefix).parent
    for row in ROWS:
        if not only or row.name in only:
            turns = [[measure(each, row) for each in (old, here)] for _ in range(rounds)]
            before, now = map(min, zip(*turns, strict=True))
            yield row, before, now


def table(old: Path, only: tuple[str, ...], rounds: int) -> str:
    """Every figure at both commits, the ratio and its goal, as Markdown."""
    found = []
    for row, before, now in compared(old, only, rounds):
        bound = "-" if row.goal is None else f"at most {row.goal:g}"
        cells = f"{before:.4g} {row.unit}", f"{now:.4g} {row.unit}", f"{now / before:.2f}"
        found.append((row.what, *cells, bound))
    return markdown(("figure", "earlier commit", "here", "ratio", "goal"), found)


def groups_table(rounds: int) -> str:
    """What a period of small groups costs here, in times of one of 16 rigs, as Markdown."""
    here, sizes = Path(sys.prefix).parent, (LARGE_GROUP, *SMALL_GROUPS)
    rows = [Row("groups", "", "us", SIMULATED, each, ("circle",)) for each in sizes]
    turns = [[measure(here, row) for row in rows] for _ in range(rounds)]
    large, *small = (min(turn) for turn in zip(*turns, strict=True))
    goal = f"at most {SMALL_GROUP_GOAL:g}"
    found = [
        (f"{size} rigs", f"{took:.4g} us", f"{took / large:.2f}", goal)
        for size, took in zip(SMALL_GROUPS, small, strict=True)
    ]
    return markdown(("group", "here", f"times that of {LARGE_GROUP}", "goal"), found)


@click.command()
@click.argument("old", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--only",
    type=click.Choice(sorted({"groups", *(row.name for row in ROWS)})),
    multiple=True,
    help="Compare this alone.",
)
@click.option("--rounds", type=int, default=3, help="Turns of either.")
def main(old: Path, only: tuple[str, ...], rounds: int) -> None:
    """Print what each figure costs at the checkout OLD and here, and its goal."""
    if only != ("groups",):
        click.echo(table(old.resolve(), only, rounds) + "\n")
    if not only or "groups" in only:
        click.echo(groups_table(rounds))


if __name__ == "__main__":
    main()
