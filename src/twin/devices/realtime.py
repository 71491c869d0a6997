"""Real time for the loop: absolute deadlines, timing of every tick, and what Linux does for it.

A loop that misses periods skips them. A processor that sleeps between two periods begins the next
one late and with cold caches; Linux keeps all of them awake while a program holds its request for a
latency of zero open.
"""

from __future__ import annotations

import gc
import os
import struct
import sys
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from itertools import accumulate
from typing import Any, NamedTuple

from twin.base.errors import plural
from twin.hal.interface import Condition, Fault, Severity

LATE_SHARE = 0.25
"""Share of a period from which a tick counts as late."""
BLAMED_SHARE = 0.05
"""Share of late or missed periods above which a fault is attributed to the computer."""
MAX_LATE_PERIODS = 5.0
"""Periods that a single one must be late for the same."""
MISSED_PER_PROMPT = 2
"""Missed periods that one in time makes up for: a plate is held well at a third of the periods."""


class LatencyHistogram:
    """Durations in bins of a microsecond up to a limit; beyond it only the longest is kept.

    Args:
        limit: In s.
    """

    def __init__(self, limit: float = 0.02) -> None:
        self.number = 0
        """Number of durations."""
        self.longest = 0.0
        """The longest, s."""
        self._top = round(1e6 * limit)
        self._bins = [0] * (self._top + 1)

    def add(self, seconds: float) -> None:
        """Count one duration."""
        self.number += 1
        self.longest = max(self.longest, seconds)
        index = int(1e6 * seconds + 0.5)
        self._bins[index if 0 <= index < self._top else (self._top if index > 0 else 0)] += 1

    def quantile(self, share: float) -> float:
        """Quantile of the durations in s, to the microsecond: a share 0..1 do not exceed it.

        Beyond the limit the longest of all; 0 if nothing was counted.
        """
        index = bisect_left(list(accumulate(self._bins)), max(1, share * self.number))
        return 1e-6 * index if index < self._top else self.longest

    def as_dict(self) -> dict[str, Any]:
        """Number, p50, p99 and max, in microseconds."""
        return {
            "number": self.number,
            "p50_us": round(1e6 * self.quantile(0.5)),
            "p99_us": round(1e6 * self.quantile(0.99)),
            "max_us": round(1e6 * self.longest),
        }


class TimingLog:
    """Lateness, missed periods and stage durations of one run.

    Args:
        period: Control period in s.
        now: Clock in s.
    """

    def __init__(self, period: float, now: Callable[[], float] = time.perf_counter) -> None:
        self.period = period
        self.ticks = 0
        """Periods that were begun."""
        self.missed = 0
        """Periods that were skipped because the one before took too long."""
        self.late = 0
        """Periods that began late by more than ``LATE`` of a period."""
        self.lateness = LatencyHistogram()
        self.trips = LatencyHistogram()
        """Times from a command on the bus to the last answer."""
        self.stages: dict[str, LatencyHistogram] = {}
        self.pauses: list[float] = []
        """How long the computer paused, s, where a virtual rig waited for it."""
        self._now = now
        self._mark = 0.0

    def tick(self, lateness: float, missed: int = 0) -> None:
        """Count a period that began late by some s after skipping a number of others."""
        self.ticks += 1
        self.missed += missed
        self.lateness.add(lateness)
        self.late += lateness > LATE_SHARE * self.period

    def begin(self) -> None:
        """Start the stopwatch for the stages of a period."""
        self._mark = self._now()

    def mark(self, stage: str) -> None:
        """Count the time since the last mark, or since ``begin``, as duration of a stage."""
        now = self._now()
        if stage not in self.stages:
            self.stages[stage] = LatencyHistogram()
        self.stages[stage].add(now - self._mark)
        self._mark = now

    def as_dict(self) -> dict[str, Any]:
        """All statistics, for the record of a run."""
        return {
            "period_us": round(1e6 * self.period),
            "ticks": self.ticks,
            "missed": self.missed,
            "late": self.late,
            "lateness": self.lateness.as_dict(),
            "stages": {name: stage.as_dict() for name, stage in self.stages.items()},
            "round_trip": self.trips.as_dict(),
            "pauses_us": [round(1e6 * pause) for pause in self.pauses],
        }

    def text(self) -> list[str]:
        """The statistics in a few lines, for the end of a run."""
        due = max(1, self.ticks + self.missed)
        lines = [
            f"{plural(self.ticks, 'tick')} of {1e3 * self.period:g} ms, {self.missed} missed "
            f"({100 * self.missed / due:.2f} %), {self.late} late by more than "
            f"{1e3 * LATE_SHARE * self.period:g} ms",
            _line("lateness", self.lateness),
        ]
        lines += [_line(name, stage) for name, stage in self.stages.items()]
        if self.trips.number:
            lines.append(_line("bus round trip", self.trips))
        if self.pauses:
            lines.append(
                f"the computer paused {plural(len(self.pauses), 'time')}, "
                f"{1e3 * sum(self.pauses):.0f} ms in "
                "all; the virtual rig's time stood still meanwhile, a real rig does not wait"
            )
        return lines


def describe_lateness(ledger: Mapping[str, Any]) -> str:
    """One line if the computer was too late, by a run's ``TimingLog.as_dict``; else empty."""
    slow = ledger["missed"] + ledger["late"]
    due = max(1, ledger["ticks"] + ledger["missed"])
    longest = ledger["lateness"]["max_us"]
    if slow / due < BLAMED_SHARE and longest < MAX_LATE_PERIODS * ledger["period_us"]:
        return ""
    # after missed periods the next one begins in time
    worst = (
        f", one by {1e-3 * longest:.0f} ms" if longest > LATE_SHARE * ledger["period_us"] else ""
    )
    return (
        f"this computer was too late, not the rig: {slow} of {due} periods were late or missed"
        f"{worst}; close other programs, or allow real-time priority (docs/wire.md), and run it "
        "again"
    )


def _line(name: str, times: LatencyHistogram) -> str:
    p50, p99, most = (1e3 * t for t in (times.quantile(0.5), times.quantile(0.99), times.longest))
    return f"{name}: p50 {p50:.3f} ms, p99 {p99:.3f} ms, max {most:.3f} ms"


LOOP_OVERRUN = Condition(
    "loop overrun",
    Severity.LEVEL,
    0.21,
    "the plate is levelled and held",
    "close other programs, allow real-time priority, then run again",
    periods=105,
)


Paused = Callable[[float, float], float]
"""Of a time in which a loop did not come round, beginning and end in s: how much of it its computer
paused, s."""


def never(begin: float, end: float) -> float:
    """A real rig does not wait for its computer."""
    return 0.0


class RealTimeClock:
    """A clock with periods that begin at fixed times, whatever happens in between.

    It sleeps until shortly before a deadline and spins the rest: a sleep alone wakes up some
    50 to 100 us late. A loop that took longer than its period goes on at the next deadline to
    come; the periods it missed are counted, never caught up with in a burst.

    Args:
        period: In s.
        spin: Time in s before a deadline that is spent spinning.
        allowed: Missed periods that are a fault, if not made up for: each period that is begun
            makes up for ``PAID`` of them. The default is a gap of 50 ms at 2 ms, just before the
            drives miss the heartbeat, or every fourth period alone for 0.2 s.
        paused: Called with the beginning and the end, both in s of ``now``, of a time in which the
            loop made no turn; returns how long, s, a virtual rig waits for its computer.
        now: Clock in s.
        sleep: Sleeps for a number of s.
    """

    def __init__(
        self,
        period: float,
        *,
        spin: float = 2e-4,
        allowed: int = 25,
        paused: Paused = never,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.period = period
        self.timing = TimingLog(period)
        """Statistics of lateness."""
        self._spin = spin
        self._allowed = allowed
        self._paused = paused
        self._now = now
        self._sleep = sleep
        self._faults: list[Fault] = []
        self.start()

    def start(self) -> None:
        """Let the first period begin now."""
        self._start = self._round = self._now()
        self.tick = 0
        """Periods since the start, missed ones included."""
        self.lateness = 0.0
        """How late the current period began, s."""
        self._owed = 0

    @property
    def time(self) -> float:
        """When the current period was due to begin, s since the start."""
        return self.tick * self.period

    @property
    def left(self) -> float:
        """Seconds until the next period begins that has not begun yet."""
        passed = self._now() - self._start
        return (max(self.tick, int(passed / self.period)) + 1) * self.period - passed

    def since_start(self, at: float | None) -> float:
        """Seconds from the start to a time of the clock's own, or to now."""
        return (self._now() if at is None else at) - self._start

    def wait(self) -> None:
        """Return at the beginning of the next period that has not begun yet."""
        now = self._waited_for()
        # The period that contains this moment has begun: of those in between none can be kept.
        missed = max(0, int((now - self._start) / self.period) - self.tick)
        self.tick += missed + 1
        deadline = self._start + self.tick * self.period
        pause = deadline - now - self._spin
        if pause > 0:
            self._sleep(pause)
            now = self._waited_for()
            deadline = self._start + self.tick * self.period
        while now < deadline:
            now = self._now()
        self._count(now - deadline, missed)

    def faults(self) -> tuple[Fault, ...]:
        """Overruns since the last call."""
        faults, self._faults = tuple(self._faults), []
        return faults

    def _waited_for(self) -> float:
        """Now, s; the start of the periods is put off by what was paused since last asked."""
        pause = self._paused(self._round, self._now())  # which may wait for the virtual rig
        self._round = now = self._now()
        if pause:
            self._start += pause
            self.timing.pauses.append(pause)
        return now

    def _count(self, lateness: float, missed: int) -> None:
        self.lateness = lateness
        self.timing.tick(lateness, missed)
        before = self._owed
        self._owed = max(0, before - MISSED_PER_PROMPT) + missed
        if before < self._allowed <= self._owed:
            detail = f"{plural(missed, 'period')} of {1e3 * self.period:g} ms missed"
            if missed < self._allowed:
                detail += f" for one that was begun, {self._owed} more than it can make up for"
            self._faults.append(Fault(LOOP_OVERRUN, "control loop", detail))


LOOP_PRIORITY = 80
MAX_THREAD_SWITCH_S = 2e-4
"""Longest time in s for which a different Python thread keeps the loop from running."""
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_LATENCY_DEVICE = "/dev/cpu_dma_latency"


class Scheduling(NamedTuple):
    """The real-time rights that were obtained.

    Attributes:
        fifo: Whether the loop's thread runs before all ordinary ones (SCHED_FIFO).
        locked: Whether no page of the process can be swapped out.
        words: The same in words, with what to do where it was refused.
    """

    fifo: bool
    locked: bool
    words: tuple[str, ...]


@contextmanager
def real_time(priority: int = LOOP_PRIORITY) -> Iterator[Scheduling]:
    """Run the calling thread as a real-time loop needs it; all is undone on leaving.

    The garbage collector is off, and existing objects are moved to its permanent generation.
    Threads started meanwhile stay ordinary ones. An operating system other than Linux
    grants neither priority nor locked memory, which is no error.

    Args:
        priority: Of SCHED_FIFO, 1..99.
    """
    collecting, switch = gc.isenabled(), sys.getswitchinterval()
    with ExitStack() as undo:
        fifo = _prioritise(priority, undo)
        locked = _lock(undo)
        awake = _keep_awake(undo)
        gc.collect()
        gc.freeze()
        gc.disable()
        sys.setswitchinterval(MAX_THREAD_SWITCH_S)
        try:
            words = _words(fifo, locked, priority)
            yield Scheduling(fifo, locked, (*words, "processors kept awake") if awake else words)
        finally:
            sys.setswitchinterval(switch)
            gc.unfreeze()
            if collecting:
                gc.enable()


def _prioritise(priority: int, undo: ExitStack) -> bool:
    if sys.platform != "linux":
        return False
    before, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        _come_first(priority)
    except OSError:
        return False
    undo.callback(os.sched_setscheduler, 0, before, parameter)
    return True


def _come_first(priority: int) -> None:
    # Reset on fork: threads and processes begun from this thread do not inherit the priority.
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def ahead(work: Callable[[], None]) -> Callable[[], None]:
    """The same work, for a thread that must not wait for the calling real-time loop.

    Short work only: where the calling thread has a real-time priority, this one's is just above it.
    """
    if sys.platform != "linux" or not os.sched_getparam(0).sched_priority:
        return work
    priority = os.sched_getparam(0).sched_priority + 1

    def first() -> None:
        _come_first(priority)
        work()

    return first


def _lock(undo: ExitStack) -> bool:
    if sys.platform != "linux":
        return False  # other systems have other flags
    import ctypes  # noqa: PLC0415  # only a real-time run needs it

    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        return False
    undo.callback(library.munlockall)
    return True


def _keep_awake(undo: ExitStack) -> bool:
    with suppress(OSError):
        request = os.open(_LATENCY_DEVICE, os.O_WRONLY)
        undo.callback(os.close, request)
        return os.write(request, struct.pack("i", 0)) > 0
    return False


def _words(fifo: bool, locked: bool, priority: int) -> tuple[str, ...]:
    advice = "add '{}' for the user to /etc/security/limits.conf"
    if sys.platform != "linux":
        advice = "only Linux grants it"
    return (
        f"real-time priority {priority} (SCHED_FIFO)"
        if fifo
        else "no real-time priority: " + advice.format("rtprio 99"),
        "memory locked" if locked else "memory not locked: " + advice.format("memlock unlimited"),
        "garbage collector off",
    )
