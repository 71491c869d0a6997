"""Makes cure_demands.md: references the plate cannot give, and pushes, under the cure and others.

uv run python docs/cure_demands.py
uv run python docs/cure_demands.py --moving    # cure_moving.md: references under way at the start
What has been simulated is kept in runs/demands and used again while the code stays the same.
"""

from __future__ import annotations

import inspect
import sys
from functools import partial
from typing import Any, NamedTuple

import click
import numpy as np

from docs.pages import HERE, driven, filled, kept, planned, write
from twin.base.errors import ScenarioError
from twin.run.assemble import assemble
from twin.run.controller_building import build_reference
from twin.study.schema import draw_rigs, read_family
from twin.study.work import Builder, code, digest

AREA = np.array((0.2, 0.12))
"""Within which goals lie, m along x and y."""
EVERY = 5
AFTER = 1500
"""Periods after a push in which a ball that is lost from it is lost."""
BACK = 0.005
"""Distance in m from its reference within which a ball is back."""
NUMBER, RIGS = 200, 20
"""References, and pushes; rigs of the family that they are tried on by turns."""
MOVING = 20
"""References on the nominal rig, and on those of the family, that are under way at the start."""
FEW = ("LQR", "AFL", "backstepping", "the cure")
"""Laws that they are tried under."""
PLAN = planned("cure")
KNOWN = {each["name"]: each["set"] for each in PLAN["laws"]}
CURE = "the cure"
LAWS = {
    "pole placement": ["controller.kind=pole_placement"],
    "LQR": ["controller.kind=lqr"],
    "AFL": KNOWN["AFL, thesis"],
    "AFL with integral action": KNOWN["AFL with integral action, thesis"],
    "backstepping": KNOWN["backstepping, thesis"],
    "sliding mode": ["controller.kind=sliding_mode"],
    CURE: list(KNOWN.values())[-1],
}


class Run(NamedTuple):
    """One run: settings, and the blow that its ball gets."""

    settings: list[str]
    tick: int = 0
    blow: tuple[float, float] = (0.0, 0.0)


def references(number: int) -> list[Run]:
    """Squares, stars, random goals, transitions and figures by turns."""
    rng, found = np.random.default_rng(1), []
    for turn in range(number):
        tau = np.exp(rng.uniform(np.log(0.01), np.log(0.3)))
        corners, begin = np.empty((0, 2)), np.zeros(2)
        match turn % 5:
            case 0:
                a, b = rng.uniform(0.05, 1, 2) * AREA
                corners = np.array([(a, b), (-a, b), (-a, -b), (a, -b)] * 2)
                times = np.arange(8) * rng.uniform(1.5, 4)
            case 1:
                angle = 4 * np.pi * np.arange(10) / 5
                corners = rng.uniform(0.04, 0.12) * np.stack((np.cos(angle), np.sin(angle)), 1)
                times = np.arange(10) * rng.uniform(1, 3)
            case 2:
                times = np.cumsum(rng.uniform(0.5, 3, 10))
                corners = rng.uniform(-1, 1, (10, 2)) * AREA
            case 3:
                begin, end = rng.uniform(-1, 1, (2, 2)) * AREA
                more = f"start={begin.tolist()},end={end.tolist()},time=2.0"
                text = f'kind="transition",{more},duration={rng.uniform(0.2, 2)}'
            case 4:
                omega, size = rng.uniform(0.5, 4, 2), rng.uniform(0.2, 1, 2) * AREA
                text = f'kind="lissajous",amplitude={size.tolist()},omega={omega.tolist()}'
        if len(corners):
            begin, goals = corners[0], np.column_stack((times, corners)).tolist()
            text = f'kind="setpoints",points={goals},time_constant={tau}'
        start = [f"plant.start.{axis}={at}" for axis, at in zip("xy", begin, strict=True)]
        found.append(Run([f"reference={{{text}}}", "duration=14.0", *start]))
    return found


def sines(number: int) -> list[Run]:
    """Sines of 0.15 to 0.24 m and 3 to 8 rad/s along x, at full speed at time 0."""
    sizes, speeds = np.linspace(0.15, 0.24, 4), np.linspace(3, 8, number // 4)
    paths = [f"amplitude=[{size},0.0],omega={omega}" for size in sizes for omega in speeds]
    return [Run([f'reference={{kind="sine",{each}}}', "duration=6.0"]) for each in paths]


def moving(number: int) -> list[Run]:
    """Sines, cosines, circles and figures without a soft start, paths of short ramps, by turns.

    Up to 10 rad/s; the ball rests in the middle, or somewhere else.
    """
    rng, build = np.random.default_rng(5), Builder(PLAN["scenario"])
    found: list[Run] = []
    while len(found) < number:
        omega, size = np.exp(rng.uniform(np.log(0.5), np.log(10), 2)), rng.uniform(0.2, 1.2, 2)
        (a, b), turn = (size * AREA).tolist(), len(found) % 5
        each = f"amplitude={[a, b]},omega={omega.tolist()}"
        match turn:
            case 0:
                text = f'kind="sine",amplitude=[{a},0.0],omega={omega[0]}'
            case 1:
                waves = rng.choice(["sin", "cos"], 2)
                text = f'kind="sine",{each},wave=["{waves[0]}","{waves[1]}"]'
            case 2:
                way = omega[0] * rng.choice([-1, 1])
                text = f'kind="circle",amplitude={b},omega={way},start=0.0'
            case 3:
                text = f'kind="lissajous",{each},phase={rng.uniform(0, 2 * np.pi)},start=0.0'
            case 4:
                points, ramp = rng.uniform(-0.75, 0.75, (5, 2)) * AREA, rng.uniform(0.05, 0.2)
                more = f"duration={rng.uniform(1, 4)},ramp={ramp},closed=true"
                text = f'kind="path",points={points.tolist()},{more}'
        begin = rng.uniform(-1, 1, 2) * AREA * rng.integers(2)
        start = [f"plant.start.{axis}={at}" for axis, at in zip("xy", begin, strict=True)]
        settings = [f"reference={{{text}}}", "duration=6.0", *start]
        try:
            build_reference(build([*PLAN["set"], *settings], {}))
        except ScenarioError:  # beyond the operating area
            continue
        found.append(Run(settings))
    return found


def pushes(number: int) -> list[Run]:
    """Blows of up to 0.5 m/s in any direction, on hold, circle and line by turns.

    Those of draw 3 were looked at when the cure's bounds were chosen.
    """
    paths = (
        'reference={kind="hold"}',
        "reference.omega=0.75",
        'reference={kind="sine",amplitude=[0.15,0.0],omega=0.5}',
    )
    rng, found = np.random.default_rng(4), []
    for turn in range(number):
        speed, angle = rng.uniform(0.05, 0.5), rng.uniform(0, 2 * np.pi)
        blow = speed * np.cos(angle), speed * np.sin(angle)
        found.append(Run([paths[turn % 3], "duration=16.0"], int(rng.uniform(2500, 4500)), blow))
    return found


def scenarios(runs: dict[int, Run], law: list[str], family: bool) -> list[Any]:
    """Runs by their number, under a law, on the nominal rig or by turns on those of the family."""
    build, rigs = Builder(PLAN["scenario"]), draw_rigs(read_family(PLAN["family"]), 31, RIGS)
    return [
        build(
            [*PLAN["set"], *run.settings, *law, f"seed={number}"],
            rigs[number % RIGS].point if family else {},
        )
        for number, run in runs.items()
    ]


def push(rig: Any, blows: Any) -> None:
    """Change the velocity of balls at once, m/s."""
    ball = rig.devices.state[:, (0, 1, 4, 5)].copy()
    ball[:, 1::2] += blows
    rig.devices.place(ball)


def simulated(runs: list[Run], law: list[str], family: bool) -> list[list[float | None]]:
    """Of each run the RMS distance from its reference in mm and the time it took to be back in s.

    Both None where the ball was lost.
    """
    asked = scenarios(dict(enumerate(runs)), law, family)
    rig, controller = assemble(asked, threads=1)
    ticks, blows = np.array([run.tick for run in runs]), np.array([run.blow for run in runs])

    def struck(tick: int, _: Any) -> None:
        struck_now = np.equal(ticks, tick)
        if tick and struck_now.any():
            push(rig, np.where(struck_now[:, None], blows, 0.0))

    made = driven(rig, controller, asked[0].duration, keep=struck, every=EVERY)
    record, desired, finished = made
    away = np.hypot(*np.moveaxis(record["state"][..., 0::4] - desired, -1, 0))
    found: list[list[float | None]] = []
    for number, good in enumerate(finished):
        far = away[record.time >= rig.period * ticks[number], number]
        outside = np.flatnonzero(far > BACK)
        back = EVERY * rig.period * (outside[-1] + 1) if len(outside) else 0.0
        rms = 1e3 * float(np.sqrt((far**2).mean()))
        found.append([rms, float(back)] if good else [None, None])
    return found


def lost_from_there(number: int, run: Run, law: list[str], family: bool) -> bool:
    """Whether a law loses a ball that it takes over from the cure at the moment of the push."""
    (rig, controller), (_, other) = (
        assemble(*scenarios({number: run}, each, family), threads=1) for each in (LAWS[CURE], law)
    )

    def pushed(tick: int, measurement: Any) -> None:
        if tick == run.tick:
            push(rig, run.blow)
            other.start(measurement)
            other.observer.start(controller.observer.x)
            other.rate = controller.rate
            vars(controller).update(vars(other))

    return not all(driven(rig, controller, (run.tick + AFTER) * rig.period, keep=pushed)[2])


def lost_of(asked: list[tuple[int, Run, list[str], bool]]) -> list[bool]:
    """The answers of ``lost_from_there`` to its arguments."""
    return [lost_from_there(*each) for each in asked]


def table(
    runs: list[Run], *, family: bool, column: int, laws: tuple[str, ...] = tuple(LAWS)
) -> list[tuple[str, ...]]:
    """Of every law: balls kept, the median of a column, and balls it kept that the cure lost.

    Then how many of these it loses as well, where it has the ball from the cure.
    """
    functions: tuple[Any, ...] = (scenarios, push, driven, simulated, lost_from_there)
    how = " ".join(map(inspect.getsource, functions))
    found: dict[str, list[list[float | None]]] = {}
    for name, law in ((name, LAWS[name]) for name in laws):
        key = digest(f"{code()} {how} {runs} {law} {family} {PLAN['set']}")
        found[name] = kept("demands", key, partial(simulated, runs, law, family))
        click.echo(f"{name}: {sum(each[0] is not None for each in found[name])} kept")
    rows: list[tuple[str, ...]] = []
    for name, each in found.items():
        values = np.array([value[column] for value in each], float)
        values[np.isnan(values)] = np.inf
        pairs = enumerate(zip(each, found[CURE], strict=True))
        more = [at for at, (own, cure) in pairs if own[0] is not None and cure[0] is None]
        asked = [(at, runs[at], LAWS[name], family) for at in more]
        key = digest(f"{code()} {how} {LAWS[CURE]} {asked}")
        too = kept("demands", key, partial(lost_of, asked))
        held, median = len(runs) - each.count([None, None]), np.median(values)
        shown = f"{median:.1f}" if np.isfinite(median) else "lost"
        told = ("", "") if name == CURE else (str(len(more)), str(sum(too)))
        rows.append((name, f"{held} of {len(runs)}", shown, *told))
    return rows


def main() -> None:
    """Simulate what is not kept, then write the page."""
    if sys.argv[1:] == ["--moving"]:
        found = {
            "sines": table(sines(40), family=False, column=0, laws=FEW),
            "others": table(moving(MOVING), family=False, column=0, laws=FEW),
            "others_family": table(moving(MOVING), family=True, column=0, laws=FEW),
        }
        text = filled("cure_moving", number=MOVING, rigs=RIGS, family=PLAN["family"], **found)
        write(HERE / "cure_moving.md", text)
        return
    asked = (("references", references(NUMBER), 0), ("pushes", pushes(NUMBER), 1))
    parts = {
        name + "_family" * family: table(runs, family=family, column=column)
        for name, runs, column in asked
        for family in (False, True)
    }
    text = filled("cure_demands", number=NUMBER, rigs=RIGS, family=PLAN["family"], **parts)
    write(HERE / "cure_demands.md", text)


if __name__ == "__main__":
    main()
