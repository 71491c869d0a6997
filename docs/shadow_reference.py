"""Makes shadow_reference.md: how often `shadow --reference` is right about a log.

uv run python docs/shadow_reference.py

Rigs of the family `uncertain`. The twin is learned from a reference log of each, and compared
with the beginning of other logs of it: healthy ones, and ones of a rig that has changed before.
Healthy logs, and ones of a rig that changes later, are evaluated to their end. Constants of the
comparison are set from the calibration rigs, which are not those that are judged. What has been
tried is kept in runs/shadow_reference and used again while the code stays the same.
"""

from __future__ import annotations

import inspect
import json
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from scipy.optimize import minimize

from controllers.arrays import Array
from docs.pages import HERE, filled, kept, wilson, write
from docs.shadow_trials import (
    DELAY,
    FAMILY,
    HEALTHY,
    HEALTHY_SCENARIOS,
    LEVEL,
    ROLLING,
    counted,
    whole_settings,
)
from twin.base.errors import TwinError
from twin.cli.output import progress
from twin.identify.balls import ball_inertia
from twin.identify.logs import Log
from twin.scenario.load import load
from twin.scenario.schema import at_study_step
from twin.shadow.belief import logs
from twin.shadow.causes import likely
from twin.shadow.evidence import gaps
from twin.shadow.follow import shadow
from twin.shadow.learning import (
    COMPARED_PARAMETERS,
    HEALTHY_CHANGE_STDS,
    LEARNING_S,
    MAX_CHANCE_STDS,
    SAME_MOTION_SHARE,
    Difference,
    HealthyTwin,
    ball_track,
    beginning,
    compare_with_reference,
    fit_belief,
    learn,
    motion_distance,
    prepare_for,
    shift_parameters,
)
from twin.shadow.reference import learn_reference, learn_twin
from twin.shadow.report import watched_twin
from twin.study.schema import draw_rigs, read_family
from twin.study.work import digest

DRAWS = {"calibration": 63_001, "beginning": 63_003, "watched": 63_003}
"""Seeds of the draws of rigs, of what is done with them: constants are set, the beginning of their
logs is compared, their logs are evaluated to the end."""
REFERENCE_S, BEGINNING_S, WATCHED_S = 30.0, LEARNING_S + 1.0, 61.0
"""Seconds of a reference log, of a log of which only the beginning counts, and of one that is
evaluated to its end."""
REFERENCE_MOTION = HEALTHY_SCENARIOS[0]
"""The scenario of a reference log."""
LATER_S = 40.0
"""When a rig changes that is healthy at first, s."""
REPEATS = 4
"""Logs of a calibration rig with the motion of its reference."""
TOGETHER = 5
"""Rigs that are simulated side by side."""
Settings = dict[str, Any]


class Shown(NamedTuple):
    """Parameters that show a change, and causes that are right for it."""

    parameters: tuple[str, ...]
    causes: tuple[str, ...]


LATE = "dead time +30 ms"
CHANGES = {
    "rolling friction x 2": Shown(("rolling",), ("rolling friction",)),
    "level 0.5 deg": Shown(("level_phi", "level_theta"), ("level",)),
    LATE: Shown(("delay",), ("dead time",)),
    "tilt gain -15 %": Shown(("gain",), ("tilt gain", "another ball")),
}
"""What changes of a rig, before the first row or later."""
GAIN_SHARE = 0.85
"""Share of the acceleration by gravity that is left of a ball with another gain."""


class Other(NamedTuple):
    """A log that is compared with the reference of its rig.

    Attributes:
        kind: What changes.
        scenario: Of the log.
        seconds: Its length.
        at: When it changes, s; 0 before the first row.
    """

    kind: str
    scenario: str
    seconds: float
    at: float = 0.0


def others(number: int, draw: str) -> list[Other]:
    """The logs of a rig, by its number in a draw of ``DRAWS``."""
    seconds = WATCHED_S if draw == "watched" else BEGINNING_S
    found = [Other(HEALTHY, scenario, seconds) for scenario in HEALTHY_SCENARIOS]
    if draw == "calibration":
        return found + [Other(HEALTHY, REFERENCE_MOTION, seconds)] * (REPEATS - 1)
    for place, kind in enumerate(CHANGES):
        scenario = HEALTHY_SCENARIOS[(number + place) % len(HEALTHY_SCENARIOS)]
        if draw == "watched":
            found.append(Other(kind, scenario, seconds, LATER_S))
        else:
            every = HEALTHY_SCENARIOS if kind == LATE else (scenario,)
            found += [Other(kind, each, seconds) for each in every]
    return found


def change(true: Settings, kind: str, rng: np.random.Generator) -> Settings:
    """What has become of a rig, by the keys of a scenario."""
    if kind == "rolling friction x 2":
        return {**true, ROLLING: 2 * true[ROLLING]}
    if kind == "level 0.5 deg":
        heading = rng.uniform(0, 2 * np.pi)
        way = np.array([np.cos(heading), np.sin(heading)])
        return {**true, LEVEL: (np.array(true[LEVEL]) + 0.5 * way).tolist()}
    if kind == "dead time +30 ms":
        return {**true, DELAY: true[DELAY] + 0.03}
    if kind == "tilt gain -15 %":
        ball = load("circle").plant.model
        share = 1 / (1 + ball.inertia / (ball.mass * ball.radius**2))
        inertia = ball_inertia(ball.mass, ball.radius, GAIN_SHARE * share)
        return {**true, "plant.ball.inertia": inertia}
    return true


class Rig(NamedTuple):
    """A rig of which a log is simulated.

    Attributes:
        settings: By the keys of a scenario.
        scenario: What it does.
        seed: Of its noise.
        later: What becomes of the settings at ``LATER_S``; empty for a rig that stays the same.
    """

    settings: Settings
    scenario: str
    seed: int
    later: Settings = {}  # noqa: RUF012  never changed

    def overrides(self, seconds: float) -> tuple[list[str], list[str]]:
        """Overrides of its scenario: of a rig as the project describes it, and of this one."""
        common = [f"duration={seconds}", f"seed={self.seed}"]
        own = [*common, *(f"{key}={value}" for key, value in self.settings.items())]
        new = {key: v for key, v in self.later.items() if v != self.settings.get(key)}
        if new:
            values = ", ".join(f'"{key}"={json.dumps(value)}' for key, value in new.items())
            own.append(f"change=[{{at={LATER_S}, set={{{values}}}}}]")
        return common, own


def simulate(rigs: Sequence[Rig], seconds: float) -> list[Log]:
    """Logs that do not state their rig, of a length in s."""
    pairs = []
    for rig in rigs:
        known, true = (at_study_step(load(rig.scenario, each)) for each in rig.overrides(seconds))
        pairs.append((known, true))
    return [replace(log, scenario={}) for log in logs(pairs)]


def look(log: Log, other: Other, overrides: Sequence[str], healthy: HealthyTwin) -> Settings:
    """What a twin reports of a log.

    Returns:
        Differences of its beginning from the reference, alarms after that with their causes, and
        the seconds in which there could be one.
    """
    if other.seconds == BEGINNING_S:
        usable = prepare_for(log, healthy.belief)
        gap = gaps(log, usable.period)
        found = compare_with_reference(beginning(usable), healthy, gap)
        return {"differences": [asdict(each) for each in found], "alarms": [], "watched": 0.0}
    recorded, belief = watched_twin(log, overrides)
    said = shadow(recorded, belief, learning=True, replaying=False, reference=healthy)
    alarms = [
        {"time": alarm.time, "causes": [cause.name for cause in likely(alarm.causes)]}
        for alarm in said.alarms
    ]
    return {
        "differences": [asdict(each) for each in said.differences],
        "alarms": alarms,
        "watched": said.length - LEARNING_S,
    }


def carry_out(draw: str, numbers: Sequence[int], *, identified: bool) -> list[dict[str, Any]]:
    """Compare the other logs of rigs with their references: a row of each in JSON.

    Args:
        draw: In ``DRAWS``.
        numbers: Which rigs of it.
        identified: Whether `identify` finds the twin that learns from the reference; else it is the
            rig as the project describes it.
    """
    points = draw_rigs(read_family(FAMILY), DRAWS[draw], max(numbers) + 1)
    true = {number: whole_settings(points[number].point) for number in numbers}
    seeds = {number: 10_000 * DRAWS[draw] + 100 * number for number in numbers}
    first = simulate([Rig(true[n], REFERENCE_MOTION, seeds[n]) for n in numbers], REFERENCE_S)
    work = [(n, place, each) for n in numbers for place, each in enumerate(others(n, draw))]
    rigs = []
    for number, place, other in work:
        rng = np.random.default_rng([seeds[number], place])
        new = change(true[number], other.kind, rng)
        settings, later = (true[number], new) if other.at else (new, {})
        rigs.append(Rig(settings, other.scenario, seeds[number] + 1 + place, later))
    rows = []
    references = {}
    overrides: dict[int, tuple[str, ...]] = dict.fromkeys(numbers, ())
    for number, log in zip(numbers, first, strict=True):
        with tempfile.TemporaryDirectory() as folder:
            if identified:
                overrides[number] = learn_reference(log, Path(folder)).overrides
            references[number] = learn_twin(log, overrides[number])
    recorded = simulate(rigs, work[0][2].seconds)
    for (number, _, other), log in zip(work, recorded, strict=True):
        about = {"number": number, "identified": identified, **other._asdict(), "why": ""}
        try:
            rows.append(about | look(log, other, overrides[number], references[number]))
        except TwinError as error:
            nothing = {"differences": [], "alarms": [], "watched": 0.0}
            rows.append({**about, "why": str(error), **nothing})
    return rows


def known(draw: str, numbers: tuple[int, ...], *, identified: bool) -> list[dict[str, Any]]:
    """What is found of some rigs: as kept, or tried and then kept.

    The constants of the comparison are applied afterwards, and change nothing of it.
    """
    rooms = [Path(str(files(f"twin.{room}"))) for room in ("shadow", "identify")]
    names = "belief.py belief.toml evidence.py plate.py possible.py alarms.py causes.py follow.py"
    sources = [*(rooms[0] / name for name in names.split()), *sorted(rooms[1].rglob("*.py"))]
    parts: tuple[Callable[..., Any], ...] = (
        others,
        change,
        Rig,
        simulate,
        look,
        carry_out,
        learn_twin,
        learn,
        fit_belief,
        shift_parameters,
    )
    parts += (prepare_for, beginning, ball_track, motion_distance, compare_with_reference)
    how = " ".join([each.read_text(encoding="utf-8") for each in sources])
    how += " ".join(inspect.getsource(each) for each in parts)
    key = digest(f"{how} {draw} {numbers} {identified}")
    return kept("shadow_reference", key, lambda: carry_out(draw, numbers, identified=identified))


def groups(count: int) -> list[tuple[int, ...]]:
    """Numbers of rigs that are simulated side by side."""
    return [
        tuple(range(begin, min(begin + TOGETHER, count))) for begin in range(0, count, TOGETHER)
    ]


def differences(row: Mapping[str, Any]) -> list[Difference]:
    """The parameters of a compared log, the largest deviation first."""
    found = [Difference(**each) for each in row["differences"]]
    return sorted(found, key=lambda each: -abs(each.deviation))


def significant(row: Mapping[str, Any]) -> list[Difference]:
    """Those of them that chance does not explain."""
    return [each for each in differences(row) if each.significant]


def share(hits: int, count: int) -> str:
    """How many of how many, and Wilson's 95 % interval of the share in percent."""
    if not count:
        return "- of 0"
    low, high = wilson(hits, count)
    return f"{hits} of {count} ({low:.0f} to {high:.0f} %)"


def fit_chance(
    rows: Sequence[Mapping[str, Any]], name: str, *, same_motion: bool = False
) -> tuple[float, float]:
    """The most likely scale and standard deviation between logs of a parameter.

    Changes are taken as normal with the variance (scale * fit_std)^2 + between^2.

    Args:
        rows: Of healthy logs.
        name: The parameter.
        same_motion: Whether of logs with the motion of the reference; else of those with another,
            if the parameter has a scale of its own for each.
    """
    found = changes_of(rows, name, same_motion=same_motion)
    squares = np.array([each.change / each.unit for each in found]) ** 2
    errors = np.array([each.fit_std / each.unit for each in found])
    usual = float(np.sqrt(squares.mean()))

    def cost(x: Array) -> float:
        variance = (np.exp(x[0]) * errors) ** 2 + (usual * np.exp(x[1])) ** 2
        return float((np.log(variance) + squares / variance).sum())

    # a fit does not state too large errors of itself
    bounds = [(0.0, np.log(20.0)), (np.log(1e-3), np.log(3.0))]
    starts = [(0.1, -0.1), (0.1, -4.0), (1.5, -4.0), (1.0, -1.0)]
    best = min(
        (minimize(cost, start, bounds=bounds) for start in starts), key=lambda each: each.fun
    )
    return float(np.exp(best.x[0])), usual * float(np.exp(best.x[1]))


def changes_of(
    rows: Sequence[Mapping[str, Any]], name: str, *, same_motion: bool
) -> list[Difference]:
    """The differences of a parameter; arguments as of ``fit_chance``."""
    found = [each for row in rows for each in differences(row) if each.name == name]
    if "same_motion_scale" in HEALTHY_CHANGE_STDS[name]:
        found = [each for each in found if each.same_motion == same_motion]
    return found


def calibration_row(
    rows: Sequence[Mapping[str, Any]], name: str, *, same_motion: bool = False
) -> tuple[str, ...]:
    """A row of a table: most likely constants, those in use, largest deviation with these."""
    likely_ones = fit_chance(rows, name, same_motion=same_motion)
    healthy = HEALTHY_CHANGE_STDS[name]
    used = (healthy["same_motion_scale" if same_motion else "scale"], healthy["between"])
    found = changes_of(rows, name, same_motion=same_motion)
    largest = max(abs(each.deviation) for each in found)
    own = "same_motion_scale" in healthy
    label = f"{name}, {'the same' if same_motion else 'another'} motion" if own else name
    return label, *(f"{each:.2g}" for each in (*likely_ones, *used)), f"{largest:.1f}"


def calibration_table(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Rows of all parameters, two where the motion counts."""
    return [
        calibration_row(rows, name, same_motion=same)
        for name in COMPARED_PARAMETERS
        for same in (False, True)[: 1 + ("same_motion_scale" in HEALTHY_CHANGE_STDS[name])]
    ]


def healthy_table(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Healthy logs of each scenario and of all, and how many are told to differ."""
    table = []
    for name in (*HEALTHY_SCENARIOS, "all"):
        some = [row for row in rows if name in (row["scenario"], "all")]
        table.append((name, share(sum(bool(significant(row)) for row in some), len(some))))
    return table


def changed_table(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Of each change: how many are told to differ, and by which parameter."""
    table: list[tuple[str, ...]] = []
    kinds: list[tuple[str, str, Collection[str]]]
    kinds = [(kind, kind, HEALTHY_SCENARIOS) for kind in CHANGES if kind != LATE]
    kinds += [(f"{LATE}, {scenario}", LATE, (scenario,)) for scenario in HEALTHY_SCENARIOS]
    for label, kind, scenarios in kinds:
        names = CHANGES[kind].parameters
        some = [row for row in rows if row["kind"] == kind and row["scenario"] in scenarios]
        told = [found for row in some if (found := significant(row))]
        named = sum(any(each.name in names for each in found) for found in told)
        first = sum(found[0].name in names for found in told)
        table.append((label, share(len(told), len(some)), f"{named}", f"{first}"))
    return table


def watched_table(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Healthy logs of each scenario and of all: alarms after the beginning, and their rate."""
    table: list[tuple[str, ...]] = []
    for name in (*HEALTHY_SCENARIOS, "all"):
        some = [row for row in rows if name in (row["scenario"], "all")]
        hours = sum(row["watched"] for row in some) / 3600
        count = sum(len(row["alarms"]) for row in some)
        often = counted(count, hours) if hours else "-"
        table.append((name, share(sum(bool(row["alarms"]) for row in some), len(some)), often))
    return table


def later_table(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Of each change at ``LATER_S``: early alarms, alarms in time, right causes, seconds after."""
    table: list[tuple[str, ...]] = []
    for kind, shown in CHANGES.items():
        some = [row for row in rows if row["kind"] == kind]
        early = [row for row in some if any(each["time"] < LATER_S for each in row["alarms"])]
        first = [row["alarms"][0] for row in some if row["alarms"] and row not in early]
        right = sum(bool({*each["causes"]} & {*shown.causes}) for each in first)
        after = f"{np.median([each['time'] - LATER_S for each in first]):.0f}" if first else "-"
        found = share(len(first), len(some) - len(early))
        table.append((kind, str(len(some)), str(len(early)), found, str(right), after))
    return table


def page(
    judged: Sequence[dict[str, Any]],
    calibration: Sequence[dict[str, Any]],
    whole: Sequence[dict[str, Any]],
    watched: Sequence[dict[str, Any]],
    command: str,
) -> str:
    """The page in Markdown.

    Args:
        judged: Logs of the judged rigs.
        calibration: Logs of the calibration rigs.
        whole: Logs of judged rigs with a twin that `identify` found.
        watched: Logs of judged rigs that are evaluated to their end.
        command: That makes this page.
    """
    fine, changed, own, own_changed, quiet, later = (
        [row for row in rows if (row["kind"] == HEALTHY) == well and not row["why"]]
        for rows in (judged, whole, watched)
        for well in (True, False)
    )
    tried = [row for row in calibration if not row["why"]]
    return filled(
        "shadow_reference",
        command=command,
        reference=REFERENCE_S,
        learned=LEARNING_S,
        stds=MAX_CHANCE_STDS,
        same=SAME_MOTION_SHARE,
        rigs=len({row["number"] for row in judged}),
        mute=sum(bool(row["why"]) for row in judged),
        healthy=healthy_table(fine),
        changed=changed_table(changed),
        at=LATER_S,
        until=WATCHED_S,
        watched_rigs=len({row["number"] for row in watched}),
        watched=watched_table(quiet),
        late_alarms=[
            (
                str(row["number"]),
                row["scenario"],
                f"{alarm['time']:.0f}",
                ", ".join(alarm["causes"]),
            )
            for row in quiet
            for alarm in row["alarms"]
        ],
        later=later_table(later),
        alarmed=[
            (row["number"], row["scenario"], each.words, f"{abs(each.deviation):.1f}")
            for row in fine
            for each in significant(row)
        ],
        whole_rigs=len({row["number"] for row in whole}),
        whole=healthy_table(own)[-1][1],
        whole_changed=share(sum(bool(significant(row)) for row in own_changed), len(own_changed)),
        calibration_rigs=len({row["number"] for row in tried}),
        calibration_logs=len(tried),
        calibration=calibration_table(tried),
        motions=motion_table([*tried, *fine]),
    )


def motion_table(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """How far the dead time of healthy logs is from the reference's, in ms, by their motion."""
    table: list[tuple[str, ...]] = []
    for name in HEALTHY_SCENARIOS:
        found = [
            each
            for row in rows
            if row["scenario"] == name
            for each in differences(row)
            if each.name == "delay"
        ]
        off, std = (
            1000 * np.abs([getattr(each, key) for each in found]) for key in ("change", "fit_std")
        )
        usual = [float(np.median(values)) if found else 0.0 for values in (off, std)]
        numbers = (*usual, float(off.max(initial=0.0)))
        table.append((name, str(len(found)), *(f"{each:.1f}" for each in numbers)))
    return table


@click.command()
@click.option("--rigs", type=click.IntRange(min=0), default=20, help="How many are judged.")
@click.option("--calibration", type=click.IntRange(min=1), default=10, help="Others.")
@click.option("--whole", type=click.IntRange(min=0), default=2, help="Judged rigs identified too.")
@click.option("--watched", type=click.IntRange(min=0), default=5, help="Of whole logs.")
def main(rigs: int, calibration: int, whole: int, watched: int) -> None:
    """Compare logs of simulated rigs with references, and write how often that is right."""
    counts = {
        ("beginning", False): rigs,
        ("calibration", False): calibration,
        ("beginning", True): whole,
        ("watched", False): watched,
    }
    plan = [(key, part) for key, count in counts.items() for part in groups(count)]
    rows: dict[tuple[str, bool], list[dict[str, Any]]] = {key: [] for key in counts}
    with progress("rigs with a reference", 1.0) as advance:
        for done, ((draw, identified), numbers) in enumerate(plan):
            rows[draw, identified] += known(draw, numbers, identified=identified)
            advance((done + 1) / len(plan))
    command = (
        f"uv run python docs/shadow_reference.py --rigs {rigs} --calibration {calibration} "
        f"--whole {whole} --watched {watched}"
    )
    judged, calibrated, identified_too, to_the_end = rows.values()
    text = page(judged, calibrated, identified_too, to_the_end, command)
    write(HERE / "shadow_reference.md", text)


if __name__ == "__main__":
    main()
