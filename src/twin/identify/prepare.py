"""Cleans a log: what is broken is left out, the rest is cut into segments without gaps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.base.errors import LogError, plural
from twin.identify.axis_logs import AxisLog
from twin.identify.log_columns import AXIS_COLUMNS
from twin.identify.logs import Log
from twin.identify.samples import find_noise, resolution, runs
from twin.run.logs import check_reach

COLUMNS_OF_AXIS = (("measured_x", "measured_phi"), ("measured_y", "measured_theta"))
"""Columns of the ball and of the plate along x, then along y."""


def check_ranges(log: Log) -> None:
    """Make sure that no number is beyond what the rig can do.

    Raises:
        LogError: Naming the column, and the unit its numbers look like.
    """
    touched = log.touched & np.isfinite(log.ball).all(axis=-1)
    if not touched.any():
        raise LogError(f"{log.source}: the ball is never detected")
    for axis, (ball, plate) in enumerate(COLUMNS_OF_AXIS[: log.axes]):
        check_reach(log.source, ball, log.ball[touched, axis])
        check_reach(log.source, plate, log.plate[:, axis], axes=log.axes)


SPEED_INTERVAL_S = 0.02
"""Time in s between the measured speeds that a replay gets from before its beginning."""
REST_SPEED_M_S, ROLL_SPEED_M_S = 0.004, 0.008
"""Measured speeds in m/s below which the ball rests and above which it rolls."""
SPEED_SPAN_S = 0.3
"""Time in s over which the speed is measured, and shortest rest."""
MIN_CREEP_M = 6e-4
"""Way in m from the first to the last third of a rest above which the ball creeps: some times the
noise of these means."""
MAX_EARLIER_SPEEDS = 200
"""Number of measured speeds that a replay gets from before its beginning: some seconds, the time
for which contacts age."""


def speed(time: Array, ball: Array) -> Array:
    """Speed of the ball by a local parabola through equally spaced samples, m/s, shape (K,)."""
    period = float(time[1] - time[0])
    samples = max(5, round(SPEED_SPAN_S / period) | 1)
    velocity = scipy.signal.savgol_filter(ball, samples, 2, deriv=1, delta=period, axis=0)
    return np.hypot(velocity[:, 0], velocity[:, 1])


def rests(time: Array, ball: Array, moving: Array) -> list[tuple[float, float]]:
    """When the ball rests: first and last time of each, s.

    A ball that creeps, because what pushes it is hardly more than what holds it, does not rest:
    where it will be is decided by less than a log shows.

    Args:
        time: Equally spaced seconds, shape (K,).
        ball: m, shape (K, 2).
        moving: Speed of it, m/s, shape (K,).
    """
    found = []
    for a, b in runs(moving < REST_SPEED_M_S):
        third = (b - a) // 3
        if time[b - 1] - time[a] > SPEED_SPAN_S:
            crept = ball[b - third : b].mean(axis=0) - ball[a : a + third].mean(axis=0)
            if np.hypot(*crept) < MIN_CREEP_M:
                found.append((float(time[a]), float(time[b - 1])))
    return found


def paces(segment: Segment, at: Array) -> Array:
    """Speeds of the ball before times in s, as ``Windows.paces`` has them, shape (W, K)."""
    time = segment.time
    moving = speed(time, segment.even_ball)
    still = moving.copy()
    for first, last in rests(time, segment.even_ball, moving):
        still[(time >= first) & (time <= last)] = 0.0
    return np.interp(
        at[:, None] - SPEED_INTERVAL_S * np.arange(MAX_EARLIER_SPEEDS, 0, -1), time, still
    )


def find_ball_samples(log: Log, period: float) -> tuple[Mask, Array, list[str]]:
    """Rows with a new usable ball sample, its standard deviation in m, shape (2,), and notes.

    Args:
        log: K rows.
        period: Seconds between two of them.
    """
    notes = list[str]()
    usable = log.touched & np.isfinite(log.ball).all(axis=-1)
    if (log.touched & ~usable).any():
        missing = int((log.touched & ~usable).sum())
        notes.append(f"{plural(missing, 'row')} without ball position left out")
    fresh = usable & _new_position(log.age, log.ball, period)
    sigma = _noise(log.ball[fresh], log.axes)
    spikes = np.zeros_like(fresh)
    off = log.ball[fresh] - scipy.ndimage.median_filter(
        log.ball[fresh], size=(9, 1), mode="nearest"
    )
    spikes[fresh] = (np.abs(off) > np.maximum(8 * sigma, 0.003)).any(axis=-1)
    if spikes.any():
        notes.append(
            f"{plural(int(spikes.sum()), 'ball position')} far off their neighbours left out"
        )
    return fresh & ~spikes, sigma, notes


def _new_position(age: Array, ball: Array, period: float) -> Mask:
    """Rows that bring a new ball position, not one held from before."""
    if np.ptp(age) > period / 2:
        return np.concatenate(([True], np.diff(age) < period / 2))
    change = np.concatenate(([True], (np.diff(ball, axis=0) != 0).any(axis=-1)))
    at = np.flatnonzero(change)
    lengths = np.diff(at)
    lengths = lengths[lengths * period < 0.1]
    held = int(np.median(lengths)) if len(lengths) else 1
    if held <= 1:
        return np.ones_like(change)
    since = np.arange(len(ball)) - at[np.cumsum(change) - 1]
    return np.asarray(since % held == 0)


NO_AXIS_STD_M = 1e-4
"""Standard deviation in m by which a ball is known to be at 0 along an axis that a rig has not."""


def _noise(ball: Array, axes: int) -> Array:
    """Standard deviation of one sample in m, shape (2,): of noise or of steps, 1 um at least."""
    spread = find_noise(ball)
    grid = np.array([resolution(ball[:, axis]) for axis in (0, 1)])
    found = np.asarray(np.maximum(np.maximum(spread, grid / np.sqrt(12)), 1e-6))
    return np.where(np.arange(2) < axes, found, NO_AXIS_STD_M)


MAX_ROW_INTERVAL_S = 0.05
"""Longest time in s between rows."""
MAX_BRIDGED_GAP_S = 0.012
"""Missing rows up to this time in s are bridged by a straight line."""
MIN_LIFT_S = 0.05
"""Without touch for longer than this time in s, the ball counts as off the screen."""
MIN_SEGMENT_S = 2.5
"""Segments shorter than this time in s are left out."""
WALL_MARGIN_M = 5e-4
"""Distance in m from a wall, in addition to the noise, at which a ball may touch it."""
WALL_NOISE_STDS = 3.0
"""Standard deviations of a sample by which a ball at a wall may be seen away from it."""


@dataclass(frozen=True)
class Segment:
    """A part of a log without gaps.

    Attributes:
        time: Equally spaced seconds, shape (K,).
        plate: Encoder angles (phi, theta) in rad, shape (K, 2).
        command: Commanded plate rates in rad/s, shape (K, 2), or None.
        sampled: When each ball sample was taken, the screen's delay not counted, s, shape (M,).
        ball: Ball samples in m, shape (M, 2).
    """

    time: Array
    plate: Array
    command: Array | None
    sampled: Array
    ball: Array

    def between(self, begin: float, end: float) -> Segment:
        """The part between two times in s."""
        rows = (self.time >= begin) & (self.time < end)
        samples = (self.sampled >= begin) & (self.sampled < end)
        command = None if self.command is None else self.command[rows]
        return Segment(
            self.time[rows], self.plate[rows], command, self.sampled[samples], self.ball[samples]
        )

    @property
    def even_ball(self) -> Array:
        """Ball at the equally spaced times, m, shape (K, 2)."""
        return interpolate(self.time, self.sampled, self.ball)

    @property
    def length(self) -> float:
        """Seconds."""
        return float(self.time[-1] - self.time[0]) if len(self.time) else 0.0


@dataclass(frozen=True, kw_only=True)
class PreparedLog:
    """The usable part of a log.

    Attributes:
        source: What the log is called.
        segments: Its parts.
        sigma: Standard deviation of a ball sample along x and y in m, shape (2,).
        model: The ball.
        own_lag: Lag in s of the twin's own drives without a bandwidth limit.
        grips: Times in s within which friction may stop a ball, see ``replay``.
        axes: Number of axes of the rig; of 1 the second is 0 everywhere.
        notes: What had to be left out, in words.
        wall_note: The one of them on the time at walls; empty without any.
    """

    source: str
    segments: tuple[Segment, ...]
    sigma: Array
    model: BallPlate
    own_lag: float
    grips: tuple[float, ...]
    axes: int = 2
    notes: tuple[str, ...] = ()
    wall_note: str = ""

    @property
    def period(self) -> float:
        """Seconds between rows."""
        time = self.segments[0].time
        return float(time[1] - time[0])

    @property
    def sample_period(self) -> float:
        """Median time in s between two ball positions."""
        return float(np.median(np.concatenate([np.diff(s.sampled) for s in self.segments])))

    @property
    def length(self) -> float:
        """Usable seconds."""
        return sum(segment.length for segment in self.segments)

    def split(self, share: float) -> tuple[PreparedLog, PreparedLog]:
        """The first share of the usable time, and the rest."""
        left = share * self.length
        border = self.segments[-1].time[-1]
        for segment in self.segments:
            if left <= segment.length:
                border = segment.time[0] + left
                break
            left -= segment.length
        parts = []
        for begin, end in ((-np.inf, border), (border, np.inf)):
            cut = (segment.between(begin, end) for segment in self.segments)
            parts.append(replace(self, segments=tuple(s for s in cut if s.length >= MIN_SEGMENT_S)))
        return parts[0], parts[1]


def prepare(log: Log) -> PreparedLog:
    """Leave out what is broken, and cut the rest into segments.

    Raises:
        LogError: If the clock runs backwards, or too little is left.
    """
    log, notes = _select_complete_rows(log)
    time = log.time
    if len(time) < 100:
        raise LogError(
            f"{log.source}: only {plural(len(time), 'usable row')}; too short to identify anything"
        )
    period = _period(time, log.source)
    steps = np.diff(time)
    gap = steps > max(1.5 * period, MAX_BRIDGED_GAP_S)
    if gap.any():
        missing = float(steps[gap].sum())
        notes.append(f"{plural(int(gap.sum()), 'gap')} of {missing:.2f} s in all left out")
    lifted = np.zeros_like(log.touched)
    for first, stop in runs(~log.touched):
        lifted[first:stop] = time[stop - 1] - time[first] >= MIN_LIFT_S
    if lifted.any():
        notes.append(f"ball not detected for {period * lifted.sum():.2f} s: left out")
    fresh, sigma, sample_notes = find_ball_samples(log, period)
    notes += sample_notes
    good = ~lifted & ~_find_wall_contacts(log, fresh, sigma)
    wall_note = ""
    if (walled := period * float((~good & ~lifted).sum())) > 0:
        wall_note = f"ball at a wall, or as good as, for {walled:.2f} s: left out"
        notes.append(wall_note)
    good[:-1] &= ~gap
    segments = [
        _segment(log, fresh, slice(first, stop), period)
        for first, stop in runs(good)
        if time[stop - 1] - time[first] >= MIN_SEGMENT_S
    ]
    segments = [s for s in segments if len(s.sampled) > 20]
    if not segments:
        why = notes[-1] if notes else f"it lasts {time[-1] - time[0]:.1f} s"
        if gap.mean() > 0.02:
            why += "; a clock that jitters: --columns takes such a log"
        raise LogError(f"{log.source}: no stretch of {MIN_SEGMENT_S:g} s without a gap ({why})")
    return PreparedLog(
        source=log.source,
        segments=tuple(segments),
        sigma=sigma,
        model=log.model,
        own_lag=log.own_lag,
        grips=log.grips,
        axes=log.axes,
        notes=tuple(notes),
        wall_note=wall_note,
    )


def _find_wall_contacts(log: Log, fresh: Mask, sigma: Array) -> Mask:
    """Rows in which the ball may touch a wall, shape (K,).

    A fast ball may touch it between two samples: one of them is then at most half the way from one
    sample to the next away from the wall.

    Args:
        log: K rows.
        fresh: Those with a new sample, shape (K,).
        sigma: Standard deviation of a sample along x and y in m, shape (2,).
    """
    if not fresh.any():
        return np.zeros(len(fresh), bool)
    ball, noise = np.nan_to_num(log.ball), WALL_NOISE_STDS * sigma
    steps = np.abs(np.diff(ball[fresh], axis=0, prepend=ball[fresh][:1], append=ball[fresh][-1:]))
    way = np.maximum(np.maximum(steps[:-1], steps[1:]) - noise, 0.0)
    since = np.maximum(np.cumsum(fresh) - 1, 0)
    return log.walls.is_met(ball, WALL_MARGIN_M + noise + way[since] / 2)


def log_of_axes(log: Log) -> dict[str, AxisLog]:
    """The axes of a log, each by itself, with the measured angles of the plate."""
    known = np.isfinite(log.time)
    log = log.rows(known)
    fresh, *_ = find_ball_samples(log, float(np.median(np.diff(log.time))))
    sampled, axes = (log.time - log.age)[fresh], {}
    for k, axis in enumerate(list(AXIS_COLUMNS)[: log.axes]):
        there = np.isfinite(log.plate[:, k])
        axes[axis] = AxisLog(
            log.time[there], log.plate[there, k], False, sampled, log.ball[fresh, k]
        )
    return axes


def interpolate(at: Array, time: Array, values: Array) -> Array:
    """Values (K, 2) at times (K,) in s by straight lines at others, shape (..., 2)."""
    return np.stack([np.interp(at, time, values[:, axis]) for axis in (0, 1)], axis=-1)


def _select_complete_rows(log: Log) -> tuple[Log, list[str]]:
    """The rows with time, plate angles and command, and a note on the others."""
    rows = np.isfinite(log.time) & np.isfinite(log.plate).all(axis=-1)
    if log.command is not None:
        rows &= np.isfinite(log.command).all(axis=-1)
    missing = int((~rows).sum())
    notes = (
        [f"{plural(missing, 'row')} without time, plate angle or command left out"]
        if missing
        else []
    )
    return log.rows(rows), notes


def _period(time: Array, source: str) -> float:
    steps = np.diff(time)
    period = float(np.median(steps))
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0))
        raise LogError(
            f"{source}: time: jumps from {time[row]:.6g} to {time[row + 1]:.6g} s after row "
            f"{row + 1}: times must increase"
        )
    if not 5e-5 <= period <= MAX_ROW_INTERVAL_S:
        raise LogError(
            f"{source}: time: a row every {period:.4g} s, "
            f"0.00005 to {MAX_ROW_INTERVAL_S:g} s can be used"
            + ("; milliseconds? write the header as time [ms]" if period >= 0.5 else "")
        )
    return period


def _segment(log: Log, fresh: Mask, rows: slice, period: float) -> Segment:
    """These rows with plate and command at equally spaced times."""
    time, new = log.time[rows], fresh[rows]
    even = time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-6) + 1)
    return Segment(
        even,
        interpolate(even, time, log.plate[rows]),
        None if log.command is None else interpolate(even, time, log.command[rows]),
        (time - log.age[rows])[new],
        log.ball[rows][new],
    )
