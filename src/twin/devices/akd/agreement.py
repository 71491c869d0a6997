"""Checks whether a drive's data agree with each other: velocity with position, heartbeats.

A wrong byte that passes every check of its own, as a bit of a velocity turned over, shows only
where the same motion is counted twice.
"""

from __future__ import annotations

import math
from collections import deque


class MotionAgreement:
    """Compares a motor's velocity, added up, with its position.

    Both are of the same SYNC. Velocities of a drive are filtered and lag by some ms; the shaft of
    an emulated servo follows its velocity with a time constant T, so that its position is

        integral of v - T (w - w_0),  T w' = v - w.

    A position between both, with and without T, agrees.

    Args:
        slack: Difference that is always allowed, rad at the cam shaft.
        shaft_lag: T in s.
    """

    WINDOW = 0.5
    """Seconds over which the motion is compared."""
    SHARE = 0.25
    """Share of the way turned that is allowed besides."""
    LAG = 0.03
    """Seconds by which one may lag behind the other."""

    def __init__(self, slack: float, shaft_lag: float = 0.0) -> None:
        self._slack, self._shaft_lag = slack, shaft_lag
        self._followed = 0.0
        """Velocity of a shaft that follows with that lag, rad/s."""
        self._samples: deque[tuple[float, ...]] = deque()
        """Time in s, position in rad, velocity in rad/s and added up in rad, its size likewise,
        and by how much a shaft with that lag is behind, rad."""
        self.ratio = 1.0
        """How far the position turned within the window, per velocity added up; NaN if unknown."""

    def restart(self) -> None:
        """Forget what was before."""
        self._samples.clear()
        self._followed = 0.0

    def take(self, sampled: float, angle: float, rate: float) -> float:
        """Take in a sample; by how much both differ beyond what is allowed, rad.

        Args:
            sampled: When it was taken, s; a sample of the time before is left out.
            angle: Position, rad.
            rate: Velocity, rad/s.
        """
        turned = way = 0.0
        if self._samples:
            before, _, last, turned, way, _ = self._samples[-1]
            passed = sampled - before
            if passed <= 0:
                return -self._slack
            mean = (rate + last) / 2
            turned, way = turned + mean * passed, way + abs(mean) * passed
            if self._shaft_lag:
                kept = math.exp(-passed / self._shaft_lag)
                self._followed = kept * self._followed + (1 - kept) * mean
        behind = self._shaft_lag * self._followed
        self._samples.append((sampled, angle, rate, turned, way, behind))
        while sampled - self._samples[0][0] > self.WINDOW:
            self._samples.popleft()
        _, first, rate_before, turned_before, way_before, behind_before = self._samples[0]
        by_position, by_velocity = angle - first, turned - turned_before
        self.ratio = by_position / by_velocity if abs(by_velocity) > self._slack else math.nan
        late = by_velocity - (behind - behind_before)
        off = max(min(late, by_velocity) - by_position, by_position - max(late, by_velocity), 0.0)
        allowed = self.SHARE * (way - way_before) + self.LAG * abs(rate - rate_before)
        return off - self._slack - allowed


class HeartbeatCount:
    """Counts heartbeats: those of a second node with the same id make them too many.

    Args:
        period: Seconds from one to the next of one node.
    """

    INTERVALS = 20
    """Intervals over which they are counted; a host that stalls hears some at once."""
    SHARE = 0.8
    """Share of the time that these take of one node, from which there are two."""
    STALL = 4
    """Intervals without any after which those that arrive at once have waited for the host."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._least = self.SHARE * self.INTERVALS * period
        self._arrived: deque[float] = deque(maxlen=self.INTERVALS + 1)
        self._counted_from = self._last = -math.inf

    def too_many(self, arrival: float) -> bool:
        """Take one in that arrives at a time in s; whether they are more than one node sends."""
        if arrival - self._last > self.STALL * self._period:
            self._arrived.clear()
            self._counted_from = arrival + self._period / 2
        self._last = arrival
        if arrival < self._counted_from:
            return False
        self._arrived.append(arrival)
        full = len(self._arrived) == self._arrived.maxlen
        return full and arrival - self._arrived[0] < self._least
