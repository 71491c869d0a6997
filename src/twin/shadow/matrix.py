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
from twin.shadow.injections import AT, DURATION, HEALTHY, KINDS, RAMP, Kind, logs, rig
from twin.shadow.shadow import shadow

TOGETHER = 6
"""Rigs that are simulated side by side."""
IN_TIME = 20.0
"""Seconds after a change is complete within which an alarm counts as in time."""
CALIBRATED = 10_000
"""Seeds of healthy rigs: from here on those from which the false-alarm rate is worked out,"""
JUDGED = 20_000
"""and those on which it is judged, with all that is said of healthy running."""
INJECTED = 30_000
"""Seeds of rigs that something happens to."""
HEALTHY_SCENARIOS = ("excite", "circle", "sine")


class Job(NamedTuple):
    """Rigs of one kind that are simulated side by side."""

    kind: int
    scenario: str
    seeds: tuple[int, ...]


@dataclass(frozen=True)
class Trial:
    """What was said of one rig.

    Attributes:
        seed: Which rig.
        kind: What happened to it.
        largest: Largest log-likelihood ratio.
        alarm: When there was the first alarm, s; None for never.
        causes: What it was held to be.
        squares: Squared replay errors in units of their spread, shape (W,).
        errors: Replay errors after 1 s in m, shape (W,).
    """

    seed: int
    kind: Kind
    largest: float
    alarm: float | None
    causes: tuple[str, ...]
    squares: Array
    errors: Array

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
    kind = HEALTHY if job.kind < 0 else KINDS[job.kind]
    found = []
    for seed, log in zip(
        job.seeds, logs([rig(seed, job.scenario, kind) for seed in job.seeds]), strict=True
    ):
        said = shadow(log, believed(log))
        first = said.alarms[0] if said.alarms else None
        run = said.one_second
        counted = np.zeros(0, int) if run is None else np.flatnonzero(run.counted)
        found.append(
            Trial(
                seed,
                kind,
                float(said.ratio.max()),
                None if first is None else first.time,
                () if first is None else tuple(each.name for each in likely(first.causes)),
                np.zeros(0) if run is None else run.square[counted],
                np.zeros(0) if run is None else np.hypot(*run.error[counted].T),
            )
        )
    return found


def trials(
    each: int, hours: float, processes: int, progress: Callable[[float], None] = lambda _: None
) -> list[Trial]:
    """Rigs of every kind and healthy ones.

    Args:
        each: Rigs of each kind; every second one changes along a ramp, where there can be one.
        hours: Of healthy running, half of it for working out the false-alarm rate.
        processes: That work side by side.
        progress: Called with the share of the work done.
    """
    jobs = list(_jobs(each, hours))
    found: list[Trial] = []
    for done, (_, some) in enumerate(results(carry_out, jobs, processes)):
        found += some
        progress((done + 1) / len(jobs))
    return sorted(found, key=lambda trial: trial.seed)


def _jobs(each: int, hours: float) -> Iterator[tuple[int, Job]]:
    number = 0
    for kind in range(len(KINDS)):
        for seeds in _groups(INJECTED + 1000 * kind, each):
            yield (number := number + 1), Job(kind, "excite", seeds)
    half = max(1, round(hours * 3600 / DURATION / 2 / TOGETHER)) * TOGETHER
    for first in (CALIBRATED, JUDGED):
        for index, seeds in enumerate(_groups(first, half)):
            scenario = HEALTHY_SCENARIOS[index % len(HEALTHY_SCENARIOS)]
            yield (number := number + 1), Job(-1, scenario, seeds)


def _groups(first: int, count: int) -> Iterator[tuple[int, ...]]:
    for begin in range(0, count, TOGETHER):
        yield tuple(range(first + begin, first + min(begin + TOGETHER, count)))


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


def interval(hits: int, count: int) -> str:
    """A share with its 95 % interval (Clopper and Pearson), in percent."""
    if count == 0:
        return "-"
    low = stats.beta.ppf(0.025, hits, count - hits + 1) if hits else 0.0
    high = stats.beta.ppf(0.975, hits + 1, count - hits) if hits < count else 1.0
    return f"{100 * hits / count:.0f} ({100 * low:.0f} to {100 * high:.0f})"


def inside(found: Sequence[Trial]) -> float:
    """Percentage of replays that end in their 95 % band."""
    return float(100 * (np.concatenate([each.squares for each in found]) <= BAND).mean())
