"""Real time: simulated periods held to the wall clock, and how far that succeeds."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from time import perf_counter

AHEAD = 0.004
"""Seconds the simulation may be ahead of the clock, so that it need not sleep every period."""
BEHIND = 0.1
"""Seconds behind the clock from which on it is no longer caught up with."""
OVER = 1.0
"""Seconds over which the real-time factor is taken."""


class Pace:
    """When a simulated time is due by the clock.

    Args:
        clock: Seconds of the wall clock; another one for tests.
    """

    def __init__(self, clock: Callable[[], float] = perf_counter) -> None:
        self._clock = clock
        self._passed: deque[tuple[float, float]] = deque()
        self.begin(0.0)

    def begin(self, time: float) -> None:
        """Let it be a simulated time in s now: at the start, after a pause, after going back."""
        self._zero = self._clock() - time
        self._passed.clear()

    def early(self, time: float) -> float:
        """Seconds to wait until a simulated time in s is due; 0 if it is."""
        now = self._clock()
        late = now - self._zero - time
        if late > BEHIND:
            self._zero += late - BEHIND
        self._passed.append((now, time))
        while now - self._passed[0][0] > OVER:
            self._passed.popleft()
        return -late if late < -AHEAD else 0.0

    @property
    def factor(self) -> float:
        """Simulated seconds a second of the clock, over the last second; 1 until it is known."""
        if not self._passed or self._passed[-1][0] - self._passed[0][0] < OVER / 10:
            return 1.0
        (wall, time), (wall_now, time_now) = self._passed[0], self._passed[-1]
        return (time_now - time) / (wall_now - wall)
