"""Every figure of speed: its goal, and how it is measured."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from benchmarks import (
    beside_commit,
    closed_loop,
    exact_plant,
    memory,
    start_up,
    study_speed,
    traces,
)
from twin.base.writing import write_whole
from twin.run.finished import run
from twin.run.picture import png
from twin.scenario import load
from twin.sim.plant.friction import Friction


class Goal(NamedTuple):
    """The bound of a figure.

    Attributes:
        bound: The bound.
        most: Whether it is the most, not the least, that the number may be.
    """

    bound: float
    most: bool = True

    @property
    def words(self) -> str:
        """The goal in words."""
        return f"{'at most' if self.most else 'at least'} {self.bound:g}"

    def reached(self, low: float, high: float) -> str:
        """Whether all measurements keep it, which lie between two numbers: yes, partly or no."""
        kept = [each <= self.bound if self.most else each >= self.bound for each in (low, high)]
        return "yes" if all(kept) else "partly" if any(kept) else "no"


class Figure(NamedTuple):
    """A number that was found, and what else there is to say, such as it in other units."""

    what: str
    found: float
    note: str = ""


ROLLING = Friction(rolling=1.8e-4)
GOALS: dict[str, Goal | None] = {
    **{f"ballplate {name}, times import numpy": Goal(1) for name in start_up.QUICK},
    "run circle, from the shell to the last file, times import numpy": Goal(18),
    # half of 4.6 at commit 95b7a20: 0.88 s and 0.19 s on one machine
    "picture of a run, times import numpy": Goal(2.3),
    # 6.4 and 1.0 when frames of traces were messages of python-can
    "ballplate trace of 16,000 frames, times import numpy": Goal(4),
    "reading a log of candump, times python-can's reader": Goal(0.8),
    # set when it was 3.7 to 5.9
    "closed loop of one rig, sine, times bare mj_step, least": Goal(3.2),
    "closed loop of one rig, sine, times bare mj_step, median": Goal(3.2),
    "closed loop of one rig, circle, times bare mj_step, least": None,
    "closed loop of one rig, circle, times bare mj_step, median": None,
    "exact plant, without friction, times as fast as plain RK4": Goal(3, most=False),
    "exact plant, constant friction, times as fast as plain RK4": Goal(8, most=False),
    "runs of 16 s of a study, times those at a step of 1 ms": None,
    # measured beside a checkout of that commit until commit c694846c
    "the same, times those of commit 95b7a20": Goal(1.8, most=False),
    **{row.figure: None if row.goal is None else Goal(row.goal) for row in beside_commit.ROWS},
    **{f"memory of a {what}, MiB per 1,000 runs": None for what, *_ in memory.ROWS},
}
"""What is measured, in the order of the page, and its goal if it has one."""


def commands(rounds: int) -> Iterator[Figure]:
    """Commands that only say something, in times of ``import numpy``."""
    numpy, found = start_up.ratios(start_up.QUICK, rounds + 2)
    for name, ratio in found.items():
        note = f"import numpy: {1000 * numpy:.0f} ms"
        yield Figure(f"ballplate {name}, times import numpy", ratio, note)


def whole_run(_: int) -> Iterator[Figure]:
    """A whole run and its picture, in times of ``import numpy``."""
    numpy, found = start_up.ratios(start_up.WHOLE, 3)
    (ratio,) = found.values()
    what = "run circle, from the shell to the last file, times import numpy"
    yield Figure(what, ratio, f"{ratio * numpy:.1f} s")
    circle = load("circle", ["plant.kind=lagrange"])
    motions = {"one": run(circle).motion, "other": run(load("circle")).motion}
    times = []
    with TemporaryDirectory() as folder:
        for _ in range(5):
            begin = time.process_time()
            drawn = png(motions, circle.title, circle.dimensions)
            write_whole(Path(folder) / "picture.png", drawn)
            times.append(time.process_time() - begin)
    note = f"{min(times):.2f} s, matplotlib already imported"
    yield Figure("picture of a run, times import numpy", min(times) / numpy, note)


def trace(rounds: int) -> Iterator[Figure]:
    """A trace of the CAN bus: decoded from the shell to the end, and only read."""
    numpy, whole, reading = traces.ratios(rounds)
    note = f"{whole * numpy:.2f} s"
    yield Figure("ballplate trace of 16,000 frames, times import numpy", whole, note)
    yield Figure("reading a log of candump, times python-can's reader", reading)


def loop(rounds: int) -> Iterator[Figure]:
    """One rig in closed loop."""
    for scenario in closed_loop.SECONDS:
        one = closed_loop.Benchmark(scenario)
        for kind, (bare, closed) in closed_loop.alternated(
            4 * rounds, one.bare, one.closed
        ).items():
            what = f"closed loop of one rig, {scenario}, times bare mj_step, {kind}"
            each = [f"{1e6 * seconds / one.steps:.0f}" for seconds in (closed, bare)]
            yield Figure(what, closed / bare, f"{each[0]} and {each[1]} us a period")


def exact(rounds: int) -> Iterator[Figure]:
    """One rig on the exact plant."""
    rates = exact_plant.commands(1000)
    for name, friction in {"without friction": None, "constant friction": ROLLING}.items():
        jobs = (partial(each, friction, rates) for each in (exact_plant.plain, exact_plant.exact))
        before, now = (
            1e6 * each / len(rates) for each in closed_loop.alternated(rounds, *jobs)["least"]
        )
        what = f"exact plant, {name}, times as fast as plain RK4"
        yield Figure(what, before / now, f"{now:.0f} and {before:.0f} us a period")


def study(rounds: int) -> Iterator[Figure]:
    """Runs of a study per hour, at its own step of physics and at 1 ms."""
    now, fine = study_speed.most((rounds + 1) // 2)
    what = "runs of 16 s of a study, times those at a step of 1 ms"
    yield Figure(what, now / fine, f"{now:.0f} and {fine:.0f} an hour of one core")


def runs_kept(_: int) -> Iterator[Figure]:
    """How the memory of many runs grows."""
    for what, program, least, most in memory.ROWS:
        few, many, more = memory.growth(program, least, most)
        note = f"{few:.0f} MiB, then {many:.0f}"
        yield Figure(f"memory of a {what}, MiB per 1,000 runs", more, note)


def beside(old: Path, rounds: int) -> Iterator[Figure]:
    """What has a goal as a ratio to an earlier commit, which is checked out in a folder."""
    for row, before, now in beside_commit.compared(old, (), rounds):
        yield Figure(row.figure, now / before, f"{now:.4g} and {before:.4g} {row.unit}")


GROUPS: dict[str, Callable[[int], Iterator[Figure]]] = {
    "commands": commands,
    "run": whole_run,
    "trace": trace,
    "loop": loop,
    "exact": exact,
    "study": study,
    "memory": runs_kept,
}
"""What can be measured by itself, by name; each is called with its rounds."""
