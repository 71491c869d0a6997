"""Makes cure_demands.md: references the plate cannot give, and pushes, under the cure and others.

uv run python docs/cure_demands.py                 # 200 references and 200 pushes
uv run python docs/cure_demands.py --number 20     # fewer, for a look
What has been simulated is kept in runs/demands and used again while the code stays the same.
"""

from __future__ import annotations

import inspect
from typing import Any, NamedTuple

import click
import numpy as np
from pages import HERE, filled, kept, planned

from twin.base.writing import write_whole
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.metrics import Ending
from twin.run.record import Recorder
from twin.study.schema import drawn, read_family
from twin.study.work import Builder, code, digest

AREA = np.array((0.2, 0.12))
"""Within which goals lie, m along x and y."""
EVERY = 5
AFTER = 1500
"""Periods after a push in which a ball that is lost from it is lost."""
BACK = 0.005
"""Distance in m from its reference within which a ball is back."""
RIGS = 20
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


def simulated(runs: list[Run], law: list[str], family: bool) -> list[list[float | None]]:
    """Of each run the RMS distance from its reference in mm and the time it took to be back in s.

    Both None where the ball was lost.
    """
    build, rigs = Builder(PLAN["scenario"]), drawn(read_family(PLAN["family"]), 31, RIGS)
    scenarios = []
    for number, run in enumerate(runs):
        rig = rigs[number % RIGS]
        settings = [*PLAN["set"], *run.settings, *law, f"seed={number}"]
        scenarios.append(build(settings, rig.point if family else {}))
    rig, controller = assemble(scenarios, threads=1)
    duration, period = scenarios[0].duration, scenarios[0].rig.period
    record = Recorder(round(duration / period), len(runs), period, keep=("state",), every=EVERY)
    ticks, blows = np.array([run.tick for run in runs]), np.array([run.blow for run in runs])

    def struck(tick: int, _: Any) -> None:
        if tick and (tick == ticks).any():
            ball = rig.devices.state[:, (0, 1, 4, 5)].copy()
            ball[:, 1::2] += np.where((tick == ticks)[:, None], blows, 0.0)
            rig.devices.place(ball)

    with np.errstate(all="ignore"):
        outcomes = drive(rig, controller, duration, record, keep=struck)
    wished = controller.reference(record.time)[0].reshape(record.length, -1, 2)
    away = np.hypot(*np.moveaxis(record["state"][..., 0::4] - wished, -1, 0))
    found: list[list[float | None]] = []
    for number, outcome in enumerate(outcomes):
        far = away[record.time >= period * ticks[number], number]
        outside = np.flatnonzero(far > BACK)
        back = EVERY * period * (outside[-1] + 1) if len(outside) else 0.0
        lost = outcome.ending is not Ending.FINISHED
        rms = 1e3 * float(np.sqrt((far**2).mean()))
        found.append([None, None] if lost else [rms, float(back)])
    return found


def lost_from_there(number: int, run: Run, law: list[str], family: bool) -> bool:
    """Whether a law loses a ball that it takes over from the cure at the moment of the push."""
    build, rigs = Builder(PLAN["scenario"]), drawn(read_family(PLAN["family"]), 31, RIGS)
    point = rigs[number % RIGS].point if family else {}
    (rig, controller), (_, other) = (
        assemble(build([*PLAN["set"], *run.settings, *each, f"seed={number}"], point), threads=1)
        for each in (LAWS[CURE], law)
    )

    def pushed(tick: int, measurement: Any) -> None:
        if tick == run.tick:
            ball = rig.devices.state[:, (0, 1, 4, 5)].copy()
            ball[:, 1::2] += run.blow
            rig.devices.place(ball)
            other.start(measurement)
            other.observer.start(controller.observer.x)
            other.rate = controller.rate
            vars(controller).update(vars(other))

    ticks, period = run.tick + AFTER, controller.period
    record = Recorder(ticks, 1, period, keep=("state",))
    with np.errstate(all="ignore"):
        (outcome,) = drive(rig, controller, ticks * period, record, keep=pushed)
    return outcome.ending is not Ending.FINISHED


def table(runs: list[Run], *, family: bool, column: int) -> list[tuple[str, ...]]:
    """Of every law: balls kept, the median of a column, and balls it kept that the cure lost.

    Then how many of these it loses as well, where it has the ball from the cure.
    """
    how = inspect.getsource(simulated)
    found = {}
    for name, law in LAWS.items():
        key = digest(f"{code()} {how} {runs} {law} {family} {PLAN['set']}")
        found[name] = kept("demands", key, lambda law=law: simulated(runs, law, family))
        click.echo(f"{name}: {sum(each[0] is not None for each in found[name])} kept")
    rows = []
    for name, each in found.items():
        values = [np.inf if value[column] is None else value[column] for value in each]
        pairs = enumerate(zip(each, found[CURE], strict=True))
        more = [at for at, (own, cure) in pairs if own[0] is not None and cure[0] is None]
        asked = [(at, runs[at], LAWS[name], family) for at in more]
        key = digest(f"{code()} {inspect.getsource(lost_from_there)} {LAWS[CURE]} {asked}")
        too = kept("demands", key, lambda asked=asked: [lost_from_there(*each) for each in asked])
        held = sum(value[0] is not None for value in each)
        median = np.median(values)
        shown = f"{median:.1f}" if np.isfinite(median) else "lost"
        told = ("", "") if name == CURE else (str(len(more)), str(sum(too)))
        rows.append((name, f"{held} of {len(runs)}", shown, *told))
    return rows


@click.command()
@click.option("--number", default=200, show_default=True, help="References, and pushes.")
def main(number: int) -> None:
    """Simulate what is not kept, then write the page."""
    parts = {
        f"{name}{'_family' if family else ''}": table(runs, family=family, column=column)
        for name, runs, column in (
            ("references", references(number), 0),
            ("pushes", pushes(number), 1),
        )
        for family in (False, True)
    }
    text = filled("cure_demands", number=number, rigs=RIGS, family=PLAN["family"], **parts)
    write_whole(HERE / "cure_demands.md", text)


if __name__ == "__main__":
    main()
