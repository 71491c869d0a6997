"""How good the shadow is: what it says of many rigs of which the truth is known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import stats

from controllers.arrays import Array
from twin.jobs import results
from twin.shadow.belief import believed
from twin.shadow.causes import likely
from twin.shadow.horizon import BAND
from twin.shadow.injections import AT, DURATION, HEALTHY, KINDS, RAMP, Drawn, Kind, logs, rig
from twin.shadow.shadow import shadows

TOGETHER = 60
"""Rigs that are simulated side by side."""
IN_TIME = 20.0
"""Seconds after a change is complete within which an alarm counts as in time."""
CALIBRATED = 10_000
"""Seeds of healthy rigs: from here on those from which the false-alarm rate is worked out,"""
JUDGED = 20_000
"""and those on which it is judged, with all that is said of healthy running."""
INJECTED = 80_000
"""Seeds of rigs that something happens to."""
CALIBRATION = 5
"""So many hours are judged for one from which the false-alarm rate is worked out."""
HEALTHY_SCENARIOS = ("excite", "circle", "sine")


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
    """Rigs that are simulated side by side."""

    scenario: str
    rigs: tuple[Member, ...]


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
    """

    seed: int
    kind: Kind
    largest: tuple[float, float]
    alarm: float | None
    causes: tuple[str, ...]
    squares: Array
    errors: Array
    uneven: float = 0.0

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


def carry_out(job: Job) -> list[Trial]:
    """Simulate the rigs of a job and let the twin run beside each."""
    found = []
    kinds = [HEALTHY if each.kind is None else KINDS[each.kind] for each in job.rigs]
    pairs = [
        rig(each.seed, job.scenario, kind, each.drawn)
        for each, kind in zip(job.rigs, kinds, strict=True)
    ]
    recorded = logs(pairs)
    beside = shadows([(log, believed(log)) for log in recorded])
    for each, kind, (_, truth), said in zip(job.rigs, kinds, pairs, beside, strict=True):
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
                np.zeros(0) if run is None else np.hypot(*run.error[counted].T),
                truth.plant.surface.spread_percent,
            )
        )
    return found


def healthy_rigs(hours: float) -> tuple[int, int]:
    """How many healthy rigs the false-alarm rate is worked out from, and how many are judged.

    Args:
        hours: Of healthy running to judge on.
    """
    least, judged = len(HEALTHY_SCENARIOS), round(hours * 3600 / DURATION)
    return max(least, judged // CALIBRATION), max(least, judged)


def trials(
    each: int,
    families: Sequence[Sequence[Drawn]],
    processes: int,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Trial]:
    """Rigs of every kind and healthy ones.

    Args:
        each: Rigs of each kind; every second one changes along a ramp, where there can be one.
        families: Healthy rigs: those from which the false-alarm rate is worked out, and those on
            which it is judged.
        processes: That work side by side.
        progress: Called with the share of the work done.
    """
    jobs = list(enumerate(_jobs(each, families)))
    found: list[Trial] = []
    for done, (_, some) in enumerate(results(carry_out, jobs, processes)):
        found += some
        progress((done + 1) / len(jobs))
    return sorted(found, key=lambda trial: trial.seed)


def _jobs(each: int, families: Sequence[Sequence[Drawn]]) -> Iterator[Job]:
    changed = [
        Member(INJECTED + 1000 * kind + number, kind)
        for number in range(each)
        for kind in range(len(KINDS))
    ]
    yield from (Job("excite", group) for group in _groups(changed))
    for first, family in zip((CALIBRATED, JUDGED), families, strict=True):
        rigs = [Member(first + index, None, drawn) for index, drawn in enumerate(family)]
        for place, scenario in enumerate(HEALTHY_SCENARIOS):
            yield from (
                Job(scenario, part) for part in _groups(rigs[place :: len(HEALTHY_SCENARIOS)])
            )


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
    low = stats.beta.ppf(0.025, hits, count - hits + 1) if hits else 0.0
    high = stats.beta.ppf(0.975, hits + 1, count - hits) if hits < count else 1.0
    return 100 * float(low), 100 * float(high)


def interval(hits: int, count: int) -> str:
    """A share with its 95 % interval, in percent."""
    if count == 0:
        return "-"
    low, high = bounds(hits, count)
    return f"{100 * hits / count:.0f} ({low:.0f} to {high:.0f})"


def inside(found: Sequence[Trial]) -> float:
    """Percentage of replays that end in their 95 % band."""
    return float(100 * (np.concatenate([each.squares for each in found]) <= BAND).mean())
