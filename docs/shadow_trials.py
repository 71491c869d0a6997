"""Makes shadow.md: what the shadow says of many simulated rigs of which the truth is known.

uv run python docs/shadow_trials.py --each 60 --hours 24 --laws 6 --doc docs/shadow.md

Healthy rigs, and ones that something happens to, under AFL and under every other law. What has
been simulated is kept in runs/shadow and used again while the code stays the same.
"""

from __future__ import annotations

import itertools
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from pages import filled, kept
from scipy import stats

from controllers.arrays import Array
from twin.cli.options import PROCESSES
from twin.cli.output import progress
from twin.jobs import cores, results
from twin.scenario.load import load
from twin.scenario.schema import Scenario, at_study_step
from twin.shadow.belief import CONSTANT, PARAMETERS, believed
from twin.shadow.diagnosis import THRESHOLD, likely
from twin.shadow.follow import shadow
from twin.shadow.horizon import BAND, MEDIAN
from twin.shadow.monitor import LATE_THRESHOLD
from twin.shadow.plate import GAPS
from twin.shadow.simulated import logs
from twin.study.family import drawn as drawn_rigs
from twin.study.family import read
from twin.study.work import code, digest
from twin.writing import write_whole

HERE = Path(__file__).parent
FAMILY = "uncertain"
"""The family of rigs from which healthy ones are drawn,"""
DRAWS = (1_801, 1_802, 1_803)
"""and the draws: to work out the false-alarm rate, to judge, and for the laws."""
DURATION = 60.0
"""Seconds of a run."""
AT = 20.0
"""When something happens, s."""
RAMP = 10.0
"""How long a ramp takes, s."""
ROLLING, BREAKAWAY = "plant.friction.rolling_mm", "plant.friction.breakaway_ratio"
DELAY, LEVEL = "sensors.touch.dead_time", "plant.level_deg"
BANDWIDTH, BACKLASH = "plant.servo.bandwidth_hz", "plant.servo.backlash_deg"
CAMS = "rig.cam_error_percent"
TOGETHER = 20
"""Rigs that are simulated side by side."""
IN_TIME = 20.0
"""Seconds after a change is complete within which an alarm counts as in time."""
CALIBRATED = 10_000
"""Seeds of healthy rigs: from here on those from which the false-alarm rate is worked out,"""
JUDGED = 20_000
"""and those on which it is judged, with all that is said of healthy running."""
INJECTED = 80_000
"""Seeds of rigs that something happens to,"""
UNDER_LAWS = 200_000
"""and of those under other laws."""
CALIBRATION = 5
"""So many hours are judged for one from which the false-alarm rate is worked out."""
HEALTHY_SCENARIOS = ("excite", "circle", "sine")
UNEVEN = (0, 2.5, 5, 10, 15, 20.1)
"""Percent by which screens are uneven, between which replays are told apart."""
GOALS = 4
"""Kinds, the first ones, that have goals."""
LAW = "afl"
"""The law of the scenarios."""
LAWS: dict[str, list[str]] = {
    LAW: [],
    **{
        path.stem: tomllib.loads(path.read_text(encoding="utf-8"))["set"]
        for path in sorted((HERE.parent / "scenarios" / "tunes").glob("*.toml"))
        if path.stem != LAW
    },
    "pid": ["controller.kind=pid"],
    "iterative_learning": ["controller.kind=iterative_learning"],
}
"""Settings of every law: those from which its gains are tuned; of the cure those it ships with."""
Drawn = Mapping[str, float | str]
Settings = dict[str, Any]
SPREADS = {"rolling": 0.15, "breakaway": 0.15, "delay": 0.003, "level": 0.05}
"""How rigs differ (standard deviations): rolling relative, breakaway ratio, s, deg."""


class Kind(NamedTuple):
    """Something that happens to a rig.

    Attributes:
        name: In words.
        causes: Which causes of ``twin.shadow.belief`` are right.
        ramps: Whether it can also come slowly.
    """

    name: str
    causes: tuple[str, ...]
    ramps: bool = True


KINDS = (
    Kind("rolling friction +30 %", ("rolling friction",)),
    Kind("level 0.1 deg", ("level",)),
    Kind("dead time +5 ms", ("dead time",)),
    Kind("another ball (steel)", ("another ball",), ramps=False),
    Kind("rolling friction -30 %", ("rolling friction",)),
    Kind("breakaway ratio +0.5", ("breakaway",)),
    Kind("servo lag 8 Hz", ("servo lag",), ramps=False),
    Kind("lost motion 0.1 deg", ("lost motion",)),
    Kind("cams 10 % wrong", ("cams",)),
    Kind("patch of three times the friction", ("rolling friction",), ramps=False),
    Kind("screen's noise x 1.5", ("sensor noise",)),
)
"""The first four are those with goals."""
HEALTHY = Kind("healthy", ())


def rig(
    seed: int,
    scenario: str = "excite",
    kind: Kind = HEALTHY,
    drawn: Drawn | None = None,
    law: str = LAW,
) -> tuple[Scenario, Scenario]:
    """What the twin believes of a rig drawn at random, and the rig itself.

    The belief is what an identification would have found: the truth but for its own errors.

    Args:
        seed: Which rig; an odd one gets a ramp where there can be one.
        scenario: What it does.
        kind: What happens to it.
        drawn: What the rig is, by dotted keys, ``key.0`` the first number of a list; by default
            it is drawn as ``SPREADS`` says.
        law: Of ``LAWS``.
    """
    rng = np.random.default_rng([seed, 18])
    known = _usual(rng) if drawn is None else _whole(drawn)
    true = _with_errors(known, rng)
    common = [f"duration={DURATION}", f"seed={seed}", *LAWS[law]]
    more = []
    if kind != HEALTHY:
        over = RAMP if seed % 2 and kind.ramps else 0.0
        more = [f"change=[{{at={AT}, over={over}, set={{{_change(kind, true, rng)}}}}}]"]
    belief, truth = ([f"{key}={value}" for key, value in each.items()] for each in (known, true))
    return (
        at_study_step(load(scenario, [*common, *belief])),
        at_study_step(load(scenario, [*common, *truth, *more])),
    )


def _usual(rng: np.random.Generator) -> Settings:
    """A rig like the one the project describes."""
    return {
        ROLLING: 0.18 * np.exp(SPREADS["rolling"] * rng.standard_normal()),
        BREAKAWAY: 1 + abs(SPREADS["breakaway"] * rng.standard_normal()),
        DELAY: 0.042 + SPREADS["delay"] * rng.standard_normal(),
        LEVEL: (SPREADS["level"] * rng.standard_normal(2)).tolist(),
    }


def _whole(drawn: Drawn) -> Settings:
    """Settings with the numbers of a list put together."""
    whole: Settings = {}
    for key, value in drawn.items():
        name, _, place = key.rpartition(".")
        if place.isdigit():
            whole.setdefault(name, []).append(value)
        else:
            whole[key] = value
    return whole


def _with_errors(known: Settings, rng: np.random.Generator) -> Settings:
    """A rig that differs from what is known of it by the errors of an identification."""
    off = dict(zip(PARAMETERS, rng.standard_normal(len(PARAMETERS)), strict=True))
    off = {name: CONSTANT[name] * error for name, error in off.items()}
    level = np.degrees([off["level_phi"], off["level_theta"]])
    true = {
        **known,
        ROLLING: known[ROLLING] * (1 + off["rolling"]),
        BREAKAWAY: max(1.0, known[BREAKAWAY] + off["breakaway"]),
        DELAY: known[DELAY] + off["delay"],
        LEVEL: (np.array(known[LEVEL]) + level).tolist(),
    }
    if BANDWIDTH in known:
        lag = 1 / (2 * np.pi * known[BANDWIDTH]) + off["lag"]
        true[BANDWIDTH] = 1 / (2 * np.pi * max(lag, 1e-3))
    if BACKLASH in known:
        true[BACKLASH] = max(0.0, known[BACKLASH] + np.degrees(GAPS[0]) * off["narrow_play"])
    if CAMS in known:
        true[CAMS] = [percent + float(100 * off["transmission"]) for percent in known[CAMS]]
    return true


def _change(kind: Kind, true: Settings, rng: np.random.Generator) -> str:
    """What happens to a rig, as the settings of a change."""
    heading = rng.uniform(0, 2 * np.pi)
    tilted = np.array(true[LEVEL]) + 0.1 * np.array([np.cos(heading), np.sin(heading)])
    return {
        "rolling friction +30 %": f'"{ROLLING}"={1.3 * true[ROLLING]}',
        "rolling friction -30 %": f'"{ROLLING}"={0.7 * true[ROLLING]}',
        "level 0.1 deg": f'"{LEVEL}"={tilted.tolist()}',
        "dead time +5 ms": f'"{DELAY}"={true[DELAY] + 0.005}',
        "another ball (steel)": '"plant.ball.mass"=0.263, "plant.ball.inertia"=4.208e-5, '
        f'"{ROLLING}"=0.05',
        "breakaway ratio +0.5": f'"{BREAKAWAY}"={true[BREAKAWAY] + 0.5}',
        "servo lag 8 Hz": f'"{BANDWIDTH}"=8.0',
        "lost motion 0.1 deg": f'"{BACKLASH}"=0.1',
        "cams 10 % wrong": f'"{CAMS}"=[10.0, 10.0]',
        "patch of three times the friction": f'"plant.surface.relative"={_patch(rng)}',
        "screen's noise x 1.5": '"sensors.touch.variance"=[1.632e-6, 3.987e-7]',
    }[kind.name]


def _patch(rng: np.random.Generator) -> str:
    """Relative friction on a grid of points, three times as much at one of the inner ones."""
    grid = np.ones((7, 5))
    grid[rng.integers(3, 5), rng.integers(2, 4)] = 3.0
    return str(grid.tolist())


class Member(NamedTuple):
    """One rig of a job: its seed, what happens to it, and what it is if it is not drawn as usual.

    Attributes:
        seed: Which rig.
        kind: Index of ``KINDS``; None for a healthy one.
        drawn: What it is, by dotted keys.
    """

    seed: int
    kind: int | None = None
    drawn: Drawn | None = None


class Job(NamedTuple):
    """Rigs that are simulated side by side, under one law."""

    scenario: str
    rigs: tuple[Member, ...]
    law: str = LAW


@dataclass(frozen=True)
class Trial:
    """What was said of one rig.

    Attributes:
        seed: Which rig.
        kind: What happened to it.
        largest: Largest log-likelihood ratio, of all causes and of the dead time alone.
        alarm: When there was the first alarm, s; None for never.
        causes: What it was held to be.
        squares: Squared replay errors in units of their spread, shape (W,).
        errors: Replay errors after 1 s in m, shape (W,).
        uneven: Standard deviation in percent by which the screen's friction differs from place to
            place.
        law: That it was under.
    """

    seed: int
    kind: Kind
    largest: tuple[float, float]
    alarm: float | None
    causes: tuple[str, ...]
    squares: Array
    errors: Array
    uneven: float = 0.0
    law: str = LAW

    @property
    def complete(self) -> float:
        """When the change was complete, s."""
        return AT + (RAMP if self.seed % 2 and self.kind.ramps else 0.0)

    @property
    def in_time(self) -> bool:
        """Whether the alarm came after the change began and soon enough."""
        return self.alarm is not None and AT <= self.alarm <= self.complete + IN_TIME

    @property
    def named(self) -> bool:
        """Whether a right cause is named or among those not told apart."""
        return bool(set(self.causes) & set(self.kind.causes))


def known(job: Job) -> list[Trial]:
    """What is said of the rigs of a job: as kept, or tried and then kept."""
    room = Path(str(files("twin.shadow"))).rglob("*.py")
    how = " ".join(each.read_text(encoding="utf-8") for each in [Path(__file__), *sorted(room)])
    found = kept("shadow", digest(f"{code()} {how} {job!r}"), lambda: [*map(told, carry_out(job))])
    return [
        Trial(
            **{
                **each,
                "kind": HEALTHY if each["kind"] is None else KINDS[each["kind"]],
                "largest": tuple(each["largest"]),
                "causes": tuple(each["causes"]),
                "squares": np.array(each["squares"]),
                "errors": np.array(each["errors"]),
            }
        )
        for each in found
    ]


def told(trial: Trial) -> dict[str, Any]:
    """A trial in JSON."""
    kind = None if trial.kind == HEALTHY else KINDS.index(trial.kind)
    numbers = {"squares": trial.squares.tolist(), "errors": trial.errors.tolist()}
    return vars(trial) | {"kind": kind, **numbers}


def carry_out(job: Job) -> list[Trial]:
    """Simulate the rigs of a job and let the twin run beside each."""
    found = []
    kinds = [HEALTHY if each.kind is None else KINDS[each.kind] for each in job.rigs]
    pairs = [
        rig(each.seed, job.scenario, kind, each.drawn, job.law)
        for each, kind in zip(job.rigs, kinds, strict=True)
    ]
    for each, kind, (_, truth), log in zip(job.rigs, kinds, pairs, logs(pairs), strict=True):
        said = shadow(log, believed(log))
        first = said.alarms[0] if said.alarms else None
        run = said.one_second
        counted = np.zeros(0, int) if run is None else np.flatnonzero(run.counted)
        found.append(
            Trial(
                each.seed,
                kind,
                (float(said.ratio.max(initial=0.0)), float(said.delayed.max(initial=0.0))),
                None if first is None else first.time,
                () if first is None else tuple(cause.name for cause in likely(first.causes)),
                np.zeros(0) if run is None else run.square[counted],
                np.zeros(0) if run is None else run.distance[counted],
                truth.plant.surface.spread_percent,
                job.law,
            )
        )
    return found


def trials(
    each: int,
    hours: float,
    laws: int,
    processes: int,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Trial]:
    """Rigs of every kind, healthy ones, and both under every other law.

    Args:
        each: Rigs of each kind; every second one changes along a ramp, where there can be one.
        hours: Of healthy running to judge on.
        laws: Healthy rigs, and rigs of each kind with goals, under each of the other laws.
        processes: That work side by side.
        progress: Called with the share of the work done.
    """
    jobs = list(enumerate(_jobs(each, hours, laws)))
    found: list[Trial] = []
    for done, (_, some) in enumerate(results(known, jobs, processes)):
        found += some
        progress((done + 1) / len(jobs))
    return sorted(found, key=lambda trial: trial.seed)


def _jobs(each: int, hours: float, laws: int) -> Iterator[Job]:
    kinds = range(len(KINDS))
    changed = [Member(INJECTED + 1000 * k + number, k) for number in range(each) for k in kinds]
    judged = max(len(HEALTHY_SCENARIOS), round(hours * 3600 / DURATION))
    counts = max(len(HEALTHY_SCENARIOS), judged // CALIBRATION), judged, laws
    family = read(FAMILY)
    healthy = [
        [rig.point for rig in drawn_rigs(family, draw, count)] if count else []
        for draw, count in zip(DRAWS, counts, strict=True)
    ]
    for number, law in enumerate(each for each in LAWS if each != LAW):
        first = UNDER_LAWS + 10_000 * number
        rigs = [Member(first + place, None, point) for place, point in enumerate(healthy[2])]
        rigs += [Member(first + 1000 * (k + 1) + n, k) for n in range(laws) for k in range(GOALS)]
        yield from (Job("excite", group, law) for group in _groups(rigs))
    yield from (Job("excite", group) for group in _groups(changed))
    for first, points in zip((CALIBRATED, JUDGED), healthy[:2], strict=True):
        rigs = [Member(first + index, None, point) for index, point in enumerate(points)]
        for place, scenario in enumerate(HEALTHY_SCENARIOS):
            chosen = rigs[place :: len(HEALTHY_SCENARIOS)]
            yield from (Job(scenario, part) for part in _groups(chosen))


def _groups(rigs: Sequence[Member]) -> Iterator[tuple[Member, ...]]:
    for begin in range(0, len(rigs), TOGETHER):
        yield tuple(rigs[begin : begin + TOGETHER])


def hours_between_alarms(largest: Sequence[float], threshold: float, seconds: float) -> float:
    """Mean hours from one false alarm to the next, by the extreme-value fit of healthy running.

    The largest of many weakly dependent values follows Gumbel's distribution, fitted here to the
    largest statistic of each run; how often it exceeds the threshold gives the average run length.

    Args:
        largest: Of each healthy run.
        threshold: Of the alarm.
        seconds: Length of a run.
    """
    place, scale = stats.gumbel_r.fit(np.asarray(largest))
    exceeded = float(stats.gumbel_r.sf(threshold, place, scale))
    return seconds / 3600 / max(exceeded, 1e-300)


def bounds(hits: int, count: int) -> tuple[float, float]:
    """The 95 % interval of a share (Clopper and Pearson), in percent."""
    low, high = stats.binomtest(hits, count).proportion_ci(method="exact")
    return 100 * float(low), 100 * float(high)


def interval(hits: int, count: int) -> str:
    """A share with its 95 % interval, in percent."""
    if count == 0:
        return "-"
    low, high = bounds(hits, count)
    return f"{100 * hits / count:.0f} ({low:.0f} to {high:.0f})"


def rates(alarms: int, hours: float) -> tuple[float, float]:
    """The exact 95 % interval of a rate per hour (Poisson)."""
    low = stats.chi2.ppf(0.025, 2 * alarms) / 2 if alarms else 0.0
    return float(low) / hours, float(stats.chi2.ppf(0.975, 2 * alarms + 2)) / 2 / hours


def counted(alarms: int, hours: float) -> str:
    """False alarms, and how many an hour that means."""
    low, high = rates(alarms, hours)
    return f"{alarms} in {hours:.2f} h ({low:.2f} to {high:.2f} per hour)"


class Alarms(NamedTuple):
    """How the alarms of some rigs came.

    Attributes:
        rigs: All of them.
        early: Those with an alarm before anything had happened; for a healthy rig every alarm is
            false, whenever it comes.
        rest: The others.
        timely: Of these those with an alarm in time.
        right: Of these those with the right cause.
    """

    rigs: list[Trial]
    early: list[Trial]
    rest: list[Trial]
    timely: list[Trial]
    right: list[Trial]

    @classmethod
    def of(cls, rigs: Iterable[Trial]) -> Alarms:
        """Those of some rigs."""
        every = list(rigs)
        early = [one for one in every if one.alarm is not None and one.alarm < AT]
        rest = [one for one in every if one.alarm is None or one.alarm >= AT]
        timely = [one for one in rest if one.in_time]
        return cls(every, early, rest, timely, [one for one in timely if one.named])

    @property
    def cells(self) -> tuple[str, ...]:
        """Rigs, in time, right, wrong, early, and after how many s half and 95 % had an alarm."""
        timely, right = len(self.timely), len(self.right)
        late = [np.inf if one.alarm is None else one.alarm - one.complete for one in self.rest]
        after = "-"
        if late:
            ends = np.quantile(late, (0.5, 0.95), method="inverted_cdf")
            after = ", ".join("never" if np.isinf(each) else f"{each:.0f}" for each in ends)
        return (
            str(len(self.rigs)),
            interval(timely, len(self.rest)),
            interval(right, timely),
            interval(timely - right, timely),
            str(len(self.early)),
            after,
        )


def goals(found: Sequence[Trial], judged: Sequence[Trial]) -> list[tuple[str, str, str]]:
    """What was to be reached, what was, and whether so few rigs can tell."""
    rows = []

    def said(low: float, high: float, least: float, most: float, unsure: str) -> str:
        if low >= least and high <= most:
            return "met"
        return "**not met**" if high < least or low > most else unsure

    def share(name: str, hits: int, count: int, least: float = 0.0, most: float = 100.0) -> None:
        if count == 0:
            rows.append((name, "-", "no rig"))
            return
        word = said(*bounds(hits, count), least, most, "too few rigs to tell")
        rows.append((name, f"{interval(hits, count)} % of {count}", word))

    for kind in KINDS[:GOALS]:
        own = Alarms.of(each for each in found if each.kind == kind)
        timely, right = len(own.timely), len(own.right)
        share(f"alarm in time for 95 %: {kind.name}", timely, len(own.rest), least=95)
        share(f"right cause in 90 %: {kind.name}", right, timely, least=90)
        share(f"wrong cause below 3 %: {kind.name}", timely - right, timely, most=3)
    false = _false(found, judged)
    alarms, hours = false[0][0] + false[1][0], false[0][1] + false[1][1]
    low, high = (24 * each for each in rates(alarms, hours))
    rows.append(
        (
            "healthy: less than one false alarm in 24 h",
            f"{24 * alarms / hours:.2g} ({low:.2g} to {high:.2g}) in 24 h",
            said(low, high, 0.0, 1.0, "too few hours to tell"),
        )
    )
    error, within = 1000 * float(np.median(_every(judged, "errors"))), inside(judged)
    name = "healthy: replay error at 1 s at most 1 mm (median)"
    rows.append((name, f"{error:.2f} mm", said(error, error, 0.0, 1.0, "")))
    name = "healthy: 93 to 97 % inside the 95 % band"
    rows.append((name, f"{within:.1f} %", said(within, within, 93, 97, "")))
    return rows


def _false(found: Sequence[Trial], judged: Sequence[Trial]) -> list[tuple[int, float]]:
    """False alarms, and in how many hours: healthy rigs, and others before something happens."""
    changed = Alarms.of(each for each in found if each.kind != HEALTHY)
    alarms = sum(each.alarm is not None for each in judged)
    early = len(changed.early), len(changed.rigs) * AT / 3600
    return [(alarms, len(judged) * DURATION / 3600), early]


def _every(some: Iterable[Trial], name: str) -> Array:
    """Squares or errors of all rigs, one behind the other."""
    return np.concatenate([np.zeros(0), *(getattr(each, name) for each in some)])


def inside(found: Iterable[Trial]) -> float:
    """Percentage of replays that end in their 95 % band."""
    return float(100 * (_every(found, "squares") <= BAND).mean())


def _healthy(
    found: Sequence[Trial], learned: Sequence[Trial], judged: Sequence[Trial]
) -> list[tuple[str, str]]:
    every, late = (
        hours_between_alarms([each.largest[test] for each in learned], threshold, DURATION)
        for test, threshold in enumerate((THRESHOLD, LATE_THRESHOLD))
    )

    def short(hours: float) -> str:
        return f"{hours:.3g}" if hours < 1e4 else "more than 10000"

    others, before = (counted(*each) for each in _false(found, judged))
    squares = _every(judged, "squares")
    rows = [
        (
            "hours between false alarms, by the extreme-value fit",
            short(1 / (1 / every + 1 / late)),
        ),
        ("of the test of all causes alone", short(every)),
        ("of the test of the dead time alone", short(late)),
        ("false alarms on the others", others),
        ("false alarms on the rigs below, before anything happens to them", before),
        (
            "median score (1: as predicted)",
            f"{np.sqrt(np.median(squares) / MEDIAN):.2f}",
        ),
        (
            "replays of 1 s inside their 95 % band",
            f"{inside(judged):.1f} % of {len(squares)}",
        ),
        ("replay error after 1 s, median", f"{1000 * np.median(_every(judged, 'errors')):.2f} mm"),
    ]
    for least, most in itertools.pairwise(UNEVEN):
        some = [each for each in judged if least <= each.uneven < most]
        errors = _every(some, "errors")
        median = f"{1000 * np.median(errors):.2f} mm" if len(errors) else "-"
        name = f"on screens uneven by {least:g} to {most:g} % ({len(some)} rigs), median"
        rows.append((name, median))
    return rows


def _confusion(found: Sequence[Trial]) -> tuple[list[str], list[list[str]]]:
    """The causes of first alarms in time, and of every kind how often each was named."""
    rows = {
        kind.name: Counter(
            each.causes[0] if each.in_time and each.causes else "no alarm in time"
            for each in found
            if each.kind == kind
        )
        for kind in KINDS
    }
    columns = sorted({cause for row in rows.values() for cause in row})
    return columns, [
        [name, *(str(row[cause] or "") for cause in columns)] for name, row in rows.items()
    ]


def _laws(found: Sequence[Trial]) -> list[tuple[str, ...]]:
    """A row for every law: false alarms in healthy running, and alarms after a change."""
    tried = [law for law in LAWS if any(each.law == law for each in found)]
    rows = []
    for law in (*tried, *(("all of these",) if tried else ())):
        some = [each for each in found if law in {each.law, "all of these"}]
        healthy = [each for each in some if each.kind == HEALTHY]
        alarms = sum(each.alarm is not None for each in healthy)
        false = counted(alarms, len(healthy) * DURATION / 3600)
        changed = Alarms.of(each for each in some if each.kind != HEALTHY)
        rows.append((law, str(len(healthy)), false, *changed.cells))
    return rows


def page(found: Sequence[Trial], command: str) -> str:
    """The page in Markdown.

    Args:
        found: What was said of every rig.
        command: That makes this page.
    """
    under_laws = [each for each in found if each.law != LAW]
    found = [each for each in found if each.law == LAW]
    learned = [each for each in found if CALIBRATED <= each.seed < JUDGED]
    judged = [each for each in found if JUDGED <= each.seed < INJECTED]
    kinds = [
        (kind.name, *Alarms.of(each for each in found if each.kind == kind).cells) for kind in KINDS
    ]
    return filled(
        "shadow",
        command=command,
        goals=goals(found, judged),
        scenarios=HEALTHY_SCENARIOS,
        seconds=DURATION,
        learned=len(learned),
        judged=len(judged),
        healthy=_healthy(found, learned, judged),
        ramp=RAMP,
        in_time=IN_TIME,
        kinds=kinds,
        confusion=_confusion(found),
        laws=_laws(under_laws),
    )


@click.command()
@click.option("--each", type=click.IntRange(min=2), default=60, help="Rigs of each kind.")
@click.option("--hours", type=click.FloatRange(min=0.1), default=24.0, help="Of healthy running.")
@click.option("--laws", type=click.IntRange(min=0), default=6, help="Rigs of a kind for each law.")
@click.option("--doc", type=click.Path(path_type=Path), default=HERE / "shadow.md")
@PROCESSES
def main(each: int, hours: float, laws: int, doc: Path, processes: int | None) -> None:
    """Try the shadow on simulated rigs, and write how good it is."""
    command = f"uv run python docs/shadow_trials.py --each {each} --hours {hours:g} --laws {laws}"
    with progress("rigs that something happens to, and healthy ones", 1.0) as advance:
        text = page(trials(each, hours, laws, processes or cores(), advance), command)
    write_whole(doc, lambda path: path.write_text(text, encoding="utf-8"))


if __name__ == "__main__":
    # what other processes work on has to lie in a module
    from shadow_trials import main as of_module

    of_module()
