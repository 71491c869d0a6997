"""Whether a log is fit to go on from: of such a rig, with commands, and known at the moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array, Mask
from controllers.interfaces import Measurement
from twin.errors import RecordError
from twin.identify.log import Log
from twin.identify.log_checks import check_ranges
from twin.scenario.schema import Scenario
from twin.whatif.smooth import path, touches

MISSED = 0.05
"""Time in s from one row to the next from which on there is a gap; a loop that is late for less
leaves the last command in force, which is known."""
UNSEEN = 0.1
"""Time in s between two touches from which on the ball's path has a gap."""


@dataclass(frozen=True, kw_only=True)
class Usable:
    """A log that the twin can go on from, its incomplete rows left out.

    Attributes:
        time: Of the rows, s, shape (K,).
        ball: Measured x and y in m, shape (K, 2); where the screen felt none, the last ones.
        plate: Measured phi and theta in rad, shape (K, 2).
        age: Seconds since the ball's position arrived, shape (K,).
        touched: Whether the screen felt the ball, shape (K,).
        command: Commanded plate rates in rad/s from each row on, shape (K, 2).
        samples: When the ball was where: times in s, (M,), and positions in m, (M, 2).
        gaps: Beginning and end in s of where the log has nothing.
        notes: A sentence on the gaps; none without.
    """

    time: Array
    ball: Array
    plate: Array
    age: Array
    touched: Mask
    command: Array
    samples: tuple[Array, Array]
    gaps: tuple[tuple[float, float], ...]
    notes: tuple[str, ...]

    def unbroken_since(self, at: float) -> float:
        """Time in s from which on there is no gap before a moment."""
        ends = [end for _, end in self.gaps if end <= at]
        return max([float(self.time[0]), *ends])

    def measurement(self, row: int) -> Measurement:
        """What the rig handed over in a row."""
        y = np.empty((1, 4))
        y[0, 0::2], y[0, 1::2] = self.ball[row], self.plate[row]
        one = slice(row, row + 1)
        return Measurement(float(self.time[row]), y, self.age[one], self.touched[one])

    def commanded(self, time: Array) -> Array:
        """Plate rates in rad/s in force at some times, shape (M, 2)."""
        return self.command[np.maximum(0, np.searchsorted(self.time, time + 1e-9) - 1)]


def judge(log: Log, scenario: Scenario, at: float) -> Usable:
    """The log as the twin can use it.

    Args:
        log: As it was read.
        scenario: What ran.
        at: The moment from which to go on, s.

    Raises:
        RecordError: If it has no commands, or does not know the moment.
        LogError: If it is of another rig, or in another unit.
    """
    if log.command is None:
        raise RecordError(
            f"{log.source}: no commands; what-if needs applied_phi_acc and applied_theta_acc, or "
            "applied_phi_rate and applied_theta_rate"
        )
    whole = np.isfinite(np.column_stack((log.time, log.plate, log.command))).all(axis=1)
    time, period = log.time[whole], scenario.rig.period
    _check_rows(log, time, period)
    check_ranges(log.rows(whole))
    if not time[0] - period / 2 <= at <= time[-1] + period / 2:
        raise RecordError(f"--at {at:g}: {log.source} goes from {time[0]:g} to {time[-1]:g} s")
    samples = touches(log, scenario.sensors.touch.dead_time)
    missing, unseen = _between(time, MISSED), _between(samples[0], UNSEEN)
    gaps = _joined([*missing, *unseen])
    for begin, end in gaps:
        if begin < at < end:
            raise RecordError(f"--at {at:g}: {log.source} has a gap from {begin:g} to {end:g} s")
    if not np.isfinite(path(np.array([at]), samples)[0]).all():
        raise RecordError(
            f"--at {at:g}: {log.source}: the ball is not seen often enough about then"
        )
    ball, touched = log.ball[whole], log.touched[whole]
    felt = touched & np.isfinite(ball).all(axis=1)
    held = np.maximum.accumulate(np.where(felt, np.arange(len(felt)), np.argmax(felt)))
    return Usable(
        time=time,
        ball=ball[held],
        plate=log.plate[whole],
        age=log.age[whole],
        touched=felt,
        command=log.command[whole],
        samples=samples,
        gaps=gaps,
        notes=_told(log.source, gaps),
    )


def _told(source: str, gaps: tuple[tuple[float, float], ...]) -> tuple[str, ...]:
    """The gaps in a sentence; none without gaps."""
    if not gaps:
        return ()
    spans = ", ".join(f"{begin:.3f} to {end:.3f} s" for begin, end in gaps[:3])
    more = f" and {len(gaps) - 3} more" if len(gaps) > 3 else ""
    return (f"{source}: gaps, which nothing is put into: {spans}{more}",)


def _check_rows(log: Log, time: Array, period: float) -> None:
    steps = np.diff(time)
    if len(time) < 2 or not (steps > 0).all():
        raise RecordError(f"{log.source}: time: must rise from row to row")
    own = float(np.median(steps))
    if abs(own - period) > 0.1 * period:
        raise RecordError(
            f"{log.source}: a row every {1000 * own:.3g} ms, but the scenario has rig.period = "
            f"{period:g} s; is it a log of this rig?"
        )


def _between(time: Array, longest: float) -> list[tuple[float, float]]:
    """Where two neighbouring times are too far apart."""
    wide = np.flatnonzero(np.diff(time) > longest)
    return [(float(time[row]), float(time[row + 1])) for row in wide.tolist()]


def _joined(gaps: list[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Gaps in the order of time, those that overlap as one."""
    found: list[tuple[float, float]] = []
    for begin, end in sorted(gaps):
        if found and begin <= found[-1][1]:
            found[-1] = found[-1][0], max(end, found[-1][1])
        else:
            found.append((begin, end))
    return tuple(found)
