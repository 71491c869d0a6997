"""A motion optimised for its information: goals between which the ball rolls, stops and starts.

A motion is a list of goals, an interval and a filter. Some are drawn at random; those that tell
most of a few rigs are changed a little, and the best is kept. It becomes a scenario, with lengths
of the usual operating area: on a rig with a smaller one they shrink with it.

Goals lie on one side and the other by turns, and the interval leaves the ball the time to rest. The
speed at the start of a window is known where the ball rests, and unknown where it rolls. From rest
all but a constant of the way a T^2/2 tells an acceleration a, not only what no straight line
follows: the information is 16 times as much (1/20 - 1/36 over 1/720). So strokes as long as a
window, each from rest, tell most of friction and level; breakaway shows at each start, and the dead
time at the speed of a long stroke.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from controllers.arrays import Array
from twin.base.errors import ScenarioError
from twin.base.writing import write_whole
from twin.identify.logs import Log
from twin.identify.parameters import DEFAULT_PARAMETERS, FITTED_SHARE
from twin.plan.experiment import (
    EXCITATIONS,
    MotionForecast,
    RigChoice,
    check_plan,
    forecast_motion,
    forecast_runs,
    round_plainly,
)
from twin.run.controller_building import build_reference
from twin.scenario.load import read
from twin.scenario.rig_tables import RigLimitsTable
from twin.scenario.schema import Scenario
from twin.scenario.variations import inline
from twin.shadow.belief import logs

PROCESSOR_S_PER_S, SLOWEST_RATIO = 0.25, 3
"""Processor time of a forecast of one rig in s for each second of its run, and a factor on it."""
LAW_TABLES = ("controller", "observer", "predictor")
"""Tables of a scenario that an optimised motion takes over."""


@dataclass(frozen=True, kw_only=True)
class MotionSearch:
    """Constants of the search for a motion.

    Attributes:
        seed: Of the random motions.
        first: Number of motions drawn at first.
        parents: Number of the best that are changed in each round.
        children: Number of changed ones of each.
        rounds: Number of rounds of changes.
        rigs: Number of drawn rigs on which motions are compared.
        intervals_s: Shortest and longest time from goal to goal.
        time_constants_s: Smallest and largest time constant of the filter of the goals.
        reaches: Smallest and largest distance of goals as a share of the operating area.
        change: Standard deviation of a change, as a share of each range.
        tested_rigs: Number of drawn rigs on which the ball must stay on the plate.
        kept_share: Share of them on which it must.
        shrinkage: Factor on the reach where it does not.
        shrinkages: Largest number of such factors.
    """

    seed: int = 0
    first: int = 8
    parents: int = 2
    children: int = 2
    rounds: int = 2
    rigs: int = 2
    intervals_s: tuple[float, float] = (2.2, 3.2)
    time_constants_s: tuple[float, float] = (0.2, 0.35)
    reaches: tuple[float, float] = (0.6, 0.9)
    change: float = 0.15
    tested_rigs: int = 40
    kept_share: float = 0.95
    shrinkage: float = 0.8
    shrinkages: int = 4


MOTION_SEARCH = MotionSearch()


@dataclass(frozen=True)
class Motion:
    """Goals of the ball, one after the other.

    Attributes:
        goals: Shares of the reach along x and y, -1 to 1, shape (K, 2).
        interval: Time from goal to goal in s.
        time_constant: Of the filter of the goals, s.
        reach: Distance of the farthest goals as a share of the operating area.
    """

    goals: Array
    interval: float
    time_constant: float
    reach: float

    @classmethod
    def draw(cls, seconds: float, random: np.random.Generator, how: MotionSearch) -> Motion:
        """A motion at random for a run of some seconds: from one side to the other and back."""
        count = int(np.ceil(seconds / how.intervals_s[0]))
        angles = random.uniform(-np.pi / 2, np.pi / 2, count)
        sides = (-1.0) ** np.arange(count)
        goals = sides[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
        ends = (how.intervals_s, how.time_constants_s, how.reaches)
        return cls(goals, *(float(random.uniform(*each)) for each in ends))

    def change(self, random: np.random.Generator, how: MotionSearch) -> Motion:
        """A motion a little different from this one."""

        def moved(value: float, ends: tuple[float, float]) -> float:
            step = how.change * (ends[1] - ends[0]) * random.standard_normal()
            return float(np.clip(value + step, *ends))

        goals = self.goals + 2 * how.change * random.standard_normal(self.goals.shape)
        return Motion(
            np.clip(goals, -1, 1),
            moved(self.interval, how.intervals_s),
            moved(self.time_constant, how.time_constants_s),
            moved(self.reach, how.reaches),
        )

    def points(self, seconds: float) -> list[list[float]]:
        """Time in s and place in m of each goal, in the usual operating area."""
        area = self.reach * np.array(RigLimitsTable().area)
        times = self.interval * np.arange(len(self.goals))
        return [
            [round(float(time), 3), *(round(float(each), 4) for each in area * goal)]
            for time, goal in zip(times, self.goals, strict=True)
            if time < seconds
        ]

    def text(self, base: str, seconds: float) -> str:
        """The motion as a scenario in TOML.

        Args:
            base: Name or file of the scenario that gives law, observer and predictor.
            seconds: Its duration.
        """
        tables = read(base)[0]
        reference = {
            "kind": "setpoints",
            "time_constant": round(self.time_constant, 3),
            "points": self.points(seconds),
        }
        lines = [
            "# Made by: ballplate identify --plan --optimise",
            'title = "Optimised excitation for identification"',
            f"duration = {seconds:g}",
            *(f"{name} = {inline(tables[name])}" for name in LAW_TABLES if name in tables),
            f"reference = {inline(reference)}",
        ]
        return "\n".join(lines) + "\n"


@dataclass(frozen=True, kw_only=True)
class OptimisedMotion:
    """The motion that was found.

    Attributes:
        motion: The motion.
        base: Scenario that gives its law.
        seconds: Duration.
        kept: Number of the tested rigs on which the ball stayed on the plate.
        tested: Number of the tested rigs.
        believed: The scenario on the nominal rig.
        forecast: What it will tell.
    """

    motion: Motion
    base: str
    seconds: float
    kept: int
    tested: int
    believed: Scenario
    forecast: MotionForecast

    @property
    def text(self) -> str:
        """The scenario in TOML."""
        return self.motion.text(self.base, self.seconds)

    def describe(self) -> str:
        """The motion in a sentence."""
        return (
            f"optimised: a goal every {self.motion.interval:.2f} s, up to "
            f"{100 * self.motion.reach:.0f} % of the operating area; the ball stays on the plate "
            f"of {self.kept} of {self.tested} drawn rigs."
        )


def write_motion(file: Path, motion: OptimisedMotion) -> None:
    """Write a motion as a scenario, or as a table for a board if the file ends in .csv.

    Raises:
        ScenarioError: If the file ends in anything else.
        RecordError: If it cannot be written.
    """
    if file.suffix == ".toml":
        write_whole(file, motion.text)
    elif file.suffix == ".csv":
        write_whole(file, format_table(motion.believed))
    else:
        raise ScenarioError(f"{file}: must end in .toml for a scenario, or .csv for a table")


def format_table(believed: Scenario) -> str:
    """The reference of a scenario as a table for a board: a row for each control period.

    Columns are the time in s, the desired position of the ball in m and its velocity in m/s, each
    along the axes of the rig.
    """
    axes = believed.plant.axes
    time = believed.rig.period * np.arange(round(believed.duration / believed.rig.period))
    place, speed = build_reference(believed)(time)[:2]
    each = (values.reshape(-1, 2)[:, :axes] for values in (place, speed))
    columns = np.column_stack((time, *each))
    names = "xy"[:axes]
    head = ",".join(("time [s]", *(f"{n} [m]" for n in names), *(f"{n}_rate [m/s]" for n in names)))
    rows = (",".join(f"{each:.6g}" for each in row) for row in columns)
    return "\n".join((head, *rows)) + "\n"


def describe_work(
    motions: int,
    seconds: float,
    choice: RigChoice,
    *,
    optimise: bool,
    how: MotionSearch = MOTION_SEARCH,
) -> str:
    """What will be forecast, and roughly how long it takes on one processor.

    Args:
        motions: Number of scenarios; 0 for the usual ones.
        seconds: Their duration.
        choice: The rigs.
        optimise: Whether a motion is sought, too.
        how: Constants of the search.
    """
    count, rigs = motions or len(EXCITATIONS[choice.axes]), choice.rigs + 1
    searched = how.first + how.rounds * how.parents * how.children
    forecasts = rigs * (count + optimise) + (how.rigs + 1) * searched * optimise
    least = forecasts * seconds * PROCESSOR_S_PER_S
    many = "a motion" if count == 1 else f"{count} motions"
    return (
        f"forecasting {many} of {seconds:g} s on "
        f"the nominal rig{f' and {choice.rigs} drawn' * bool(choice.rigs)}"
        f"{', and a search for a better one' * optimise}: about {round_plainly(least)} s of "
        f"processor time, up to {SLOWEST_RATIO} times that on a rough screen"
    )


def keeps_ball(log: Log, duration: float) -> bool:
    """Whether the ball is on the plate until the end of a run of this duration in s."""
    period = float(log.time[1] - log.time[0])
    return bool(log.time[-1] > duration - 1.5 * period and log.touched[-1])


def optimise_motion(
    base: str,
    seconds: float,
    choice: RigChoice,
    names: tuple[str, ...] = DEFAULT_PARAMETERS,
    share: float = FITTED_SHARE,
    progress: Callable[[float], None] = lambda _: None,
    how: MotionSearch = MOTION_SEARCH,
) -> OptimisedMotion:
    """Search for the motion that tells most of these parameters in a given time.

    Args:
        base: Name or file of the scenario that gives law, observer and predictor.
        seconds: Duration of the motion.
        choice: The rigs.
        names: The parameters, as ``identify`` takes them.
        share: Share of the run that will be fitted.
        progress: Called with the share of the work done.
        how: Constants of the search.

    Raises:
        ScenarioError: If anything is unknown or out of range, or no motion was found that keeps
            the ball on the plate.
    """
    asked = check_plan(seconds, choice, names)
    random = np.random.default_rng(how.seed)
    compared = replace(choice, rigs=how.rigs, draw=choice.draw + 1)
    # drives show in any motion, and are costly to forecast
    searched = tuple(name for name in asked if name != "servo") or asked
    work = how.first + how.rounds * how.parents * how.children
    done = 0
    with TemporaryDirectory() as folder:
        file = Path(folder) / "motion.toml"

        def simulate(motion: Motion, rigs: RigChoice) -> tuple[Scenario, list[Scenario]]:
            write_whole(file, motion.text(base, seconds))
            return rigs.scenarios(file, seconds)

        def score(motions: Sequence[Motion]) -> list[tuple[float, Motion]]:
            nonlocal done
            runs = [simulate(motion, compared) for motion in motions]
            every = logs([(believed, rig) for believed, rigs in runs for rig in rigs])
            found = []
            for motion, (_, rigs) in zip(motions, runs, strict=True):
                own, every = every[: len(rigs)], every[len(rigs) :]
                told = forecast_runs(file, seconds, rigs, own, searched, share)
                found.append((told.score, motion))
                done += 1
                progress(0.8 * done / work)
            return found

        best = score([Motion.draw(seconds, random, how) for _ in range(how.first)])
        for _ in range(how.rounds):
            best = sorted(best, key=lambda each: each[0])[: how.parents]
            best += score([each[1].change(random, how) for each in best * how.children])
        _, motion = min(best, key=lambda each: each[0])
        tested = replace(choice, rigs=how.tested_rigs, draw=choice.draw + 2)
        for _ in range(how.shrinkages + 1):
            believed, rigs = simulate(motion, tested)
            recorded = logs([(believed, rig) for rig in rigs[1:]])
            kept = sum(keeps_ball(log, seconds) for log in recorded)
            if kept >= how.kept_share * how.tested_rigs:
                break
            motion = replace(motion, reach=how.shrinkage * motion.reach)
        else:
            raise ScenarioError(
                f"{base}: no motion was found that keeps the ball on the plate of "
                f"{100 * how.kept_share:g} % of the rigs under its law; give another --scenario"
            )
        progress(0.9)
        write_whole(file, motion.text(base, seconds))
        forecast = forecast_motion(file, seconds, choice, asked, share)
    progress(1.0)
    return OptimisedMotion(
        motion=motion,
        base=base,
        seconds=seconds,
        kept=kept,
        tested=how.tested_rigs,
        believed=believed,
        forecast=replace(forecast, scenario="optimised"),
    )
