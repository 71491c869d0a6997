"""Every figure with a goal: what was found, and whether the goal is reached."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from benchmarks import closed_loop, drawing, exact_plant, physics_step, start_up, study_speed
from twin.sim.plant.friction import Friction

DRAWING_BEFORE = 4.6
"""Times ``import numpy`` that a picture took at commit 95b7a20, 0.88 s and 0.19 s on one machine;
what draws has changed since, so today's code cannot tell it again."""
LOOPS = {"sine": 4.2, "circle": float("nan")}
"""Goals of the closed loop; that of ``sine`` was set when it took 5.9 to 6.8 times bare physics."""


class Figure(NamedTuple):
    """A figure.

    Attributes:
        what: What is measured.
        found: The number.
        goal: The bound; NaN if there is none.
        most: Whether the goal is the most, not the least, that the number may be.
        note: What else there is to say, such as the number in other units.
    """

    what: str
    found: float
    goal: float = float("nan")
    most: bool = True
    note: str = ""

    @property
    def bound(self) -> str:
        """The goal in words."""
        if self.goal != self.goal:
            return "-"
        return f"{'at most' if self.most else 'at least'} {self.goal:g}"

    @property
    def reached(self) -> str:
        """Whether it is reached."""
        if self.goal != self.goal:
            return ""
        good = self.found <= self.goal if self.most else self.found >= self.goal
        return "yes" if good else "no"


def answering(rounds: int) -> Iterator[Figure]:
    """Commands that only say something, in times of ``import numpy``."""
    numpy, found = start_up.ratios(start_up.QUICK, rounds + 2)
    note = f"import numpy: {1000 * numpy:.0f} ms"
    for name, ratio in found.items():
        yield Figure(f"ballplate {name}, times import numpy", ratio, 1, note=note)


def running() -> Iterator[Figure]:
    """A whole run and its picture, in times of ``import numpy``."""
    numpy, found = start_up.ratios(start_up.WHOLE, 3)
    for name, ratio in found.items():
        yield Figure(
            f"{name}, from the shell to the last file, times import numpy",
            ratio,
            28,
            note=f"{ratio * numpy:.1f} s",
        )
    drawn = drawing.seconds()
    yield Figure(
        "picture of a run, times import numpy",
        drawn / numpy,
        DRAWING_BEFORE / 2,
        note=f"{drawn:.2f} s; half of the {DRAWING_BEFORE:g} of commit 95b7a20",
    )


def ticking(rounds: int) -> Iterator[Figure]:
    """One rig in closed loop and on the exact plant."""
    for scenario, goal in LOOPS.items():
        one = closed_loop.Benchmark(1, closed_loop.SECONDS[scenario], scenario)
        for kind, (bare, loop) in closed_loop.alternated(4 * rounds, one.bare, one.closed).items():
            yield Figure(
                f"closed loop of one rig, {scenario}, times bare mj_step, {kind}",
                loop / bare,
                goal,
                note=f"{1e6 * loop / one.steps:.0f} and {1e6 * bare / one.steps:.0f} us a period",
            )
    frictions = {"without friction": None, "constant friction": Friction(rolling=1.8e-4)}
    rates = exact_plant.commands(1000, 1)
    for name, friction in frictions.items():
        times = [
            (exact_plant.plain(friction, rates), exact_plant.exact(friction, rates))
            for _ in range(rounds)
        ]
        before, now = (1e6 * min(each) / len(rates) for each in zip(*times, strict=True))
        yield Figure(
            f"exact plant, {name}, times as fast as plain RK4",
            before / now,
            exact_plant.GOALS[name],
            most=False,
            note=f"{now:.0f} and {before:.0f} us a period",
        )


def studying(before: Path | None, seconds: float, rounds: int) -> Iterator[Figure]:
    """Physics at the step of studies, and their runs per hour."""
    for rigs, span in ((1, 2.0), (64, 0.2)):
        found = physics_step.ratio(rigs, span)
        name = "one rig" if rigs == 1 else f"{rigs} rigs"
        yield Figure(f"physics at 2 ms of {name}, share of the time at 1 ms", found)
    now, fine, *earlier = study_speed.most(before, seconds, rounds)
    yield Figure(
        f"runs of {seconds:g} s of a study, times those at a step of 1 ms",
        now / fine,
        note=f"{now:.0f} and {fine:.0f} an hour of one core",
    )
    for then in earlier:
        yield Figure(
            "the same, times those of commit 95b7a20",
            now / then,
            1.8,
            most=False,
            note=f"{now:.0f} and {then:.0f} an hour of one core",
        )


def figures(before: Path | None, *, quick: bool) -> Iterator[Figure]:
    """All of them, as they are found.

    Args:
        before: A checkout of commit 95b7a20 with its environment, if there is one.
        quick: Whether one round of what takes seconds will do.
    """
    rounds, seconds = (1, 1.0) if quick else (5, study_speed.SECONDS)
    yield from answering(rounds)
    if not quick:
        yield from running()
    yield from ticking(rounds)
    yield from studying(before, seconds, 1 if quick else 3)
