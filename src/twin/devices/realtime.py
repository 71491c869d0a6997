"""Real time for the loop: absolute deadlines, missed periods skipped, timing of every tick."""

from __future__ import annotations

import time
from collections.abc import Callable

from twin.devices.timing import TimingLog
from twin.hal.interface import Condition, Fault, Severity

LOOP_OVERRUN = Condition(
    "loop overrun",
    Severity.LEVEL,
    0.11,
    "the plate is levelled and held",
    "close other programs, allow real-time priority, then run again",
)

TIMING_CONDITIONS = (LOOP_OVERRUN,)
"""Every condition the clock reports."""


class RealTimeClock:
    """A clock whose periods begin at fixed points of time, whatever happens in between.

    It sleeps until shortly before a deadline and spins the rest: a sleep alone wakes up some
    50 to 100 us late. A loop that took longer than its period goes on at the next deadline to
    come; the periods it missed are counted, never caught up with in a burst.

    Args:
        period: In s.
        timing: Statistics of lateness; new ones by default.
        spin: Time in s before a deadline that is spent spinning.
        allowed: Late or missed periods in a row that are a fault; the default is 50 ms at 2 ms,
            just before the drives miss the heartbeat.
        now: Clock in s.
        sleep: Sleeps for a number of s.
    """

    def __init__(
        self,
        period: float,
        timing: TimingLog | None = None,
        *,
        spin: float = 2e-4,
        allowed: int = 25,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.period = period
        self.timing = timing or TimingLog(period)
        self.tick = 0
        """Periods since the start, missed ones included."""
        self.lateness = 0.0
        """How late the current period began, s."""
        self._spin = spin
        self._allowed = allowed
        self._now = now
        self._sleep = sleep
        self._start: float | None = None
        self._row = 0
        self._faults: list[Fault] = []

    def start(self) -> None:
        """Let the first period begin now; the first ``time`` or ``wait`` does it otherwise."""
        self._start = self._now()
        self.tick = 0
        self.lateness = 0.0
        self._row = 0

    @property
    def time(self) -> float:
        """When the current period was due to begin, s since the start."""
        if self._start is None:
            self.start()
        return self.tick * self.period

    @property
    def left(self) -> float:
        """Seconds until the next period begins; negative if it is missed already."""
        start = self._now() if self._start is None else self._start
        return start + (self.tick + 1) * self.period - self._now()

    def since_start(self, at: float | None) -> float:
        """Seconds from the start to a time of the clock's own, or to now."""
        start = self._now() if self._start is None else self._start
        return (self._now() if at is None else at) - start

    def wait(self) -> None:
        """Return at the beginning of the next period that has not begun yet."""
        if self._start is None:
            self.start()
        start = self._start or 0.0
        now = self._now()
        # The period that contains this moment has begun: of those in between none can be kept.
        missed = max(0, int((now - start) / self.period) - self.tick)
        self.tick += missed + 1
        deadline = start + self.tick * self.period
        pause = deadline - now - self._spin
        if pause > 0:
            self._sleep(pause)
            now = self._now()
        while now < deadline:
            now = self._now()
        self._count(now - deadline, missed)

    def faults(self) -> tuple[Fault, ...]:
        """Overruns since the last call."""
        faults, self._faults = tuple(self._faults), []
        return faults

    def _count(self, lateness: float, missed: int) -> None:
        self.lateness = lateness
        before = self._row
        self._row = before + missed + 1 if self.timing.tick(lateness, missed) else 0
        if before < self._allowed <= self._row:
            detail = f"{self._row} late or missed periods of {1e3 * self.period:g} ms in a row"
            self._faults.append(Fault(LOOP_OVERRUN, "control loop", detail))
