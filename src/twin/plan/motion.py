"""A motion optimised for its information: the ball starts from rest, then rolls to and fro.

A motion is a list of goals, an interval and a filter. Some are drawn at random; those that tell
most of a few rigs are changed a little, and the best is kept. It becomes a scenario, with lengths
of the usual operating area: on a rig with a smaller one they shrink with it.

Breakaway shows only where a ball starts that has rested, and most where the plate tilts slowly: the
ball then waits longest for the tilt that it needs. On most rigs it rests nowhere but at the start,
as the law moves it on after a stroke. So it rests at the centre first, and the first stroke is a
short one. Then goals lie on one side and the other by turns. Dead time and drives show where speeds
change much within a short time, so strokes follow each other without a rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from controllers.arrays import Array
from twin.base.errors import ScenarioError
from twin.base.page import round_plainly
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
)
from twin.run.controller_building import build_reference
from twin.scenario.load import read
from twin.scenario.rig_tables import RigLimitsTable
from twin.scenario.schema import Scenario
from twin.scenario.variations import inline
from twin.shadow.belief import logs

PROCESSOR_S_PER_S, SLOWEST_RATIO = 0.25, 3
"""Processor time of a forecast of one rig in s for each second of its run, and a factor on it."""
SIMULATION_S_PER_S = 0.01
"""The same of a simulation alone."""
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
        rest_s: Time in s that the ball rests at the centre at first.
        first_share: Distance of the first goal over that of the others.
        tested_rigs: Number of drawn rigs on which the ball must stay on the plate.
        kept_share: Share of them on which it must.
        shrinkage: Factor on the reach where it does not.
        tests: Largest number of motions that are tested so.
    """

    seed: int = 0
    first: int = 8
    parents: int = 2
    children: int = 2
    rounds: int = 1
    rigs: int = 2
    intervals_s: tuple[float, float] = (1.2, 1.9)
    time_constants_s: tuple[float, float] = (0.15, 0.22)
    reaches: tuple[float, float] = (0.35, 0.65)
    change: float = 0.15
    rest_s: float = 0.6
    first_share: float = 0.2
    tested_rigs: int = 40
    kept_share: float = 0.95
    shrinkage: float = 0.9
    tests: int = 8

    @property
    def motions(self) -> int:
        """Number of motions that are compared."""
        return self.first + self.rounds * self.parents * self.children


MOTION_SEARCH = MotionSearch()


@dataclass(frozen=True)
class Motion:
    """The ball rests at the centre, then follows goals.

    Attributes:
        goals: Shares of the reach along x and y, -1 to 1, shape (K, 2).
        interval: Time from goal to goal in s.
        time_constant: Of the filter of the goals, s.
        reach: Distance of the farthest goals as a share of the operating area.
        rest: Time of the first goal in s.
    """

    goals: Array
    interval: float
    time_constant: float
    reach: float
    rest: float = MOTION_SEARCH.rest_s

    @classmethod
    def draw(cls, seconds: float, random: np.random.Generator, how: MotionSearch) -> Motion:
        """A motion at random for a run of some seconds: from one side to the other and back."""
        count = int(np.ceil(seconds / how.intervals_s[0]))
        angles = random.uniform(-np.pi / 2, np.pi / 2, count)
        sides = (-1.0) ** np.arange(count)
        goals = sides[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
        goals[0] *= how.first_share
        ends = (how.intervals_s, how.time_constants_s, how.reaches)
        interval, time_constant, reach = (float(random.uniform(*each)) for each in ends)
        return cls(goals, interval, time_constant, reach, how.rest_s)

    def change(self, random: np.random.Generator, how: MotionSearch) -> Motion:
        """A motion a little different from this one."""

        def moved(value: float, ends: tuple[float, float]) -> float:
            step = how.change * (ends[1] - ends[0]) * random.standard_normal()
            return float(np.clip(value + step, *ends))

        steps = 2 * how.change * random.standard_normal(self.goals.shape)
        steps[0] *= how.first_share
        return replace(
            self,
            goals=np.clip(self.goals + steps, -1, 1),
            interval=moved(self.interval, how.intervals_s),
            time_constant=moved(self.time_constant, how.time_constants_s),
            reach=moved(self.reach, how.reaches),
        )

    def points(self, seconds: float) -> list[list[float]]:
        """Time in s and place in m of the centre and each goal, in the usual operating area."""
        area = self.reach * np.array(RigLimitsTable().area)
        times = self.rest + self.interval * np.arange(len(self.goals))
        goals = [
            [round(float(time), 3), *(round(float(each), 4) for each in area * goal)]
            for time, goal in zip(times, self.goals, strict=True)
            if time < seconds
        ]
        return [[0.0, 0.0, 0.0], *goals]

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


@dataclass(frozen=True, eq=False)
class ScoredMotion:
    """A motion and what it tells; of two the better one is less.

    Attributes:
        score: As ``MotionForecast`` has it; infinite if a ball left the plate.
        motion: The motion.
    """

    score: float
    motion: Motion

    def __lt__(self, other: ScoredMotion) -> bool:
        """Whether it tells more, or reaches less far where balls left the plate."""
        return (self.score, self.motion.reach) < (other.score, other.motion.reach)


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
    forecasts = rigs * (count + optimise) + (how.rigs + 1) * how.motions * optimise
    least = forecasts * seconds * PROCESSOR_S_PER_S
    least += optimise * how.tested_rigs * seconds * SIMULATION_S_PER_S
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
    tested = replace(choice, rigs=how.tested_rigs, draw=choice.draw + 2)
    done = 0
    with TemporaryDirectory() as folder:
        file = Path(folder) / "motion.toml"

        def simulate(motion: Motion, rigs: RigChoice) -> tuple[Scenario, list[Scenario]]:
            write_whole(file, motion.text(base, seconds))
            return rigs.scenarios(file, seconds)

        def score(motions: Sequence[Motion]) -> list[ScoredMotion]:
            nonlocal done
            runs = [simulate(motion, compared) for motion in motions]
            every = logs([(believed, rig) for believed, rigs in runs for rig in rigs])
            found = []
            for motion, (_, rigs) in zip(motions, runs, strict=True):
                own, every = every[: len(rigs)], every[len(rigs) :]
                told = math.inf
                if all(keeps_ball(log, seconds) for log in own):
                    told = forecast_runs(file, seconds, rigs, own, asked, share).score
                found.append(ScoredMotion(told, motion))
                done += 1
                progress(min(0.8, 0.8 * done / how.motions))
            return found

        every = score([Motion.draw(seconds, random, how) for _ in range(how.first)])
        for _ in range(how.rounds):
            parents = sorted(every)[: how.parents]
            every += score([each.motion.change(random, how) for each in parents * how.children])
        for _ in range(how.tests):
            best = min(every)
            believed, rigs = simulate(best.motion, tested)
            recorded = logs([(believed, rig) for rig in rigs[1:]])
            kept = sum(keeps_ball(log, seconds) for log in recorded)
            if kept >= how.kept_share * how.tested_rigs:
                break
            # with less reach it may tell less than the next best
            every.remove(best)
            every += score([replace(best.motion, reach=how.shrinkage * best.motion.reach)])
        else:
            raise ScenarioError(
                f"{base}: no motion was found that keeps the ball on the plate of "
                f"{100 * how.kept_share:g} % of the rigs under its law; give another --scenario"
            )
        progress(0.9)
        motion = best.motion
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
