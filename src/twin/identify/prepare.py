"""From a log as it was recorded to clean stretches of it, or one line on why there are none."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.identify.columns import LogError
from twin.identify.log import Log
from twin.identify.motion import resolution

SLOWEST = 0.05
"""Longest time in s between rows."""
BRIDGED = 0.012
"""Missing rows up to this time in s are bridged by a straight line."""
LIFTED = 0.05
"""Without touch for longer than this time in s, the ball counts as off the screen."""
SHORTEST = 2.5
"""Stretches shorter than this time in s are left out."""


@dataclass(frozen=True)
class Stretch:
    """A part of a log without gaps.

    Attributes:
        time: Equally spaced seconds, shape (K,).
        plate: Encoder angles (phi, theta) in rad, shape (K, 2).
        command: Commanded plate rates in rad/s, shape (K, 2), or None.
        seen: When the ball was where the samples say, but for the delay; s, shape (M,).
        ball: Ball samples in m, shape (M, 2).
    """

    time: Array
    plate: Array
    command: Array | None
    seen: Array
    ball: Array

    def between(self, begin: float, end: float) -> Stretch:
        """The part between two times in s."""
        rows = (self.time >= begin) & (self.time < end)
        samples = (self.seen >= begin) & (self.seen < end)
        command = None if self.command is None else self.command[rows]
        return Stretch(
            self.time[rows], self.plate[rows], command, self.seen[samples], self.ball[samples]
        )

    @property
    def even_ball(self) -> Array:
        """Ball at the equal times, m, shape (K, 2)."""
        return np.stack(
            [np.interp(self.time, self.seen, self.ball[:, axis]) for axis in (0, 1)], axis=-1
        )

    @property
    def length(self) -> float:
        """Seconds."""
        return float(self.time[-1] - self.time[0]) if len(self.time) else 0.0


@dataclass(frozen=True, kw_only=True)
class Data:
    """What of a log can be used.

    Attributes:
        source: What the log is called.
        stretches: Its parts.
        sigma: Standard deviation of a ball sample along x and y in m, shape (2,).
        model: The ball.
        own_lag: What the twin's own drives lag behind before any bandwidth limit, s.
        grips: Times in s within which friction may stop a ball, see ``replay``.
        notes: What had to be left out, in words.
    """

    source: str
    stretches: tuple[Stretch, ...]
    sigma: Array
    model: BallPlate
    own_lag: float
    grips: tuple[float, ...]
    notes: tuple[str, ...] = ()

    @property
    def period(self) -> float:
        """Seconds between rows."""
        time = self.stretches[0].time
        return float(time[1] - time[0])

    @property
    def sample_period(self) -> float:
        """Usual seconds between two ball positions."""
        return float(np.median(np.concatenate([np.diff(s.seen) for s in self.stretches])))

    @property
    def length(self) -> float:
        """Usable seconds."""
        return sum(stretch.length for stretch in self.stretches)

    def split(self, share: float) -> tuple[Data, Data]:
        """The first share of the usable time, and the rest."""
        left = share * self.length
        border = self.stretches[-1].time[-1]
        for stretch in self.stretches:
            if left <= stretch.length:
                border = stretch.time[0] + left
                break
            left -= stretch.length
        parts = []
        for begin, end in ((-np.inf, border), (border, np.inf)):
            cut = (stretch.between(begin, end) for stretch in self.stretches)
            parts.append(replace(self, stretches=tuple(s for s in cut if s.length >= SHORTEST)))
        return parts[0], parts[1]


def prepare(log: Log) -> Data:
    """Leave out what is broken, and cut the rest into stretches.

    Raises:
        LogError: If the clock runs backwards, or too little is left.
    """
    source, notes = log.source, list[str]()
    rows = np.isfinite(log.time) & np.isfinite(log.plate).all(axis=-1)
    if log.command is not None:
        rows &= np.isfinite(log.command).all(axis=-1)
    if (~rows).any():
        notes.append(f"{int((~rows).sum())} rows without time, plate angle or command left out")
    time = log.time[rows]
    if len(time) < 100:
        raise LogError(f"{source}: only {len(time)} usable rows; too short to identify anything")
    period = _period(time, source)
    gap = np.diff(time) > max(1.5 * period, BRIDGED)
    missing = float(np.diff(time)[gap].sum())
    if gap.any():
        notes.append(f"{int(gap.sum())} gaps of {missing:.2f} s in all left out")
    seen = time - log.age[rows]
    ball, touched = log.ball[rows], log.touched[rows]
    lifted = _long_runs(~touched, time, LIFTED)
    if lifted.any():
        notes.append(f"ball off the screen for {period * lifted.sum():.2f} s: left out")
    usable = touched & np.isfinite(ball).all(axis=-1)
    if (touched & ~usable).any():
        notes.append(f"{int((touched & ~usable).sum())} rows without ball position left out")
    fresh = usable & _fresh(log.age[rows], ball, period)
    sigma = _noise(ball[fresh])
    spikes = np.zeros_like(fresh)
    spikes[fresh] = _spikes(ball[fresh], sigma)
    if spikes.any():
        notes.append(f"{int(spikes.sum())} ball positions far off their neighbours left out")
    fresh &= ~spikes
    whole = replace(
        log, time=time, plate=log.plate[rows], command=None, ball=ball, age=seen, touched=fresh
    )
    command = None if log.command is None else log.command[rows]
    good = ~lifted
    good[:-1] &= ~gap
    stretches = [
        _stretch(whole, command, first, last, period)
        for first, last in _runs(good)
        if time[last] - time[first] >= SHORTEST
    ]
    stretches = [s for s in stretches if len(s.seen) > 20]
    if not stretches:
        why = notes[-1] if notes else f"it lasts {time[-1] - time[0]:.1f} s"
        raise LogError(f"{source}: no stretch of {SHORTEST:g} s without a gap ({why})")
    return Data(
        source=source,
        stretches=tuple(stretches),
        sigma=sigma,
        model=log.model,
        own_lag=log.own_lag,
        grips=log.grips,
        notes=tuple(notes),
    )


def _period(time: Array, source: str) -> float:
    steps = np.diff(time)
    period = float(np.median(steps))
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0))
        raise LogError(
            f"{source}: time: jumps from {time[row]:.6g} to {time[row + 1]:.6g} s after row "
            f"{row + 1}: the clock must run forwards"
        )
    if period > SLOWEST:
        raise LogError(
            f"{source}: time: a row every {period:.4g} s, at most {SLOWEST:g} s can be used"
            + ("; milliseconds? write the header as time [ms]" if period >= 0.5 else "")
        )
    if period < 5e-5:
        raise LogError(f"{source}: time: a row every {period:.2g} s cannot be; seconds are wanted")
    return period


def _runs(mask: Mask) -> list[tuple[int, int]]:
    """First and last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True))


def _long_runs(mask: Mask, time: Array, least: float) -> Mask:
    """The runs of True that last at least a time in s."""
    out = np.zeros_like(mask)
    for first, last in _runs(mask):
        if time[last] - time[first] >= least:
            out[first : last + 1] = True
    return out


def _fresh(age: Array, ball: Array, period: float) -> Mask:
    """Rows that bring a new ball position, not one held from before."""
    if np.ptp(age) > period / 2:
        return np.concatenate(([True], np.diff(age) < period / 2))
    change = np.concatenate(([True], (np.diff(ball, axis=0) != 0).any(axis=-1)))
    at = np.flatnonzero(change)
    runs = np.diff(at)
    runs = runs[runs * period < 0.1]
    held = int(np.median(runs)) if len(runs) else 1
    if held <= 1:
        return np.ones_like(change)
    since = np.arange(len(ball)) - at[np.cumsum(change) - 1]
    return np.asarray(since % held == 0)


def _noise(ball: Array) -> Array:
    """Standard deviation of one sample, from how three in a row differ from a line."""
    bend = np.diff(ball, n=2, axis=0)
    spread = np.median(np.abs(bend), axis=0) / (0.6745 * np.sqrt(6))
    grid = np.array([resolution(ball[:, axis]) for axis in (0, 1)])
    return np.asarray(np.maximum(np.maximum(spread, grid / np.sqrt(12)), 1e-6))


def _spikes(ball: Array, sigma: Array) -> Mask:
    usual = median_filter(ball, size=(9, 1), mode="nearest")
    return np.asarray((np.abs(ball - usual) > np.maximum(8 * sigma, 0.003)).any(axis=-1))


def _stretch(whole: Log, command: Array | None, first: int, last: int, period: float) -> Stretch:
    rows = slice(first, last + 1)
    time = whole.time[rows]
    even = time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-6) + 1)

    def at_even(values: Array) -> Array:
        return np.stack([np.interp(even, time, values[rows, axis]) for axis in (0, 1)], axis=-1)

    new = whole.touched[rows]
    return Stretch(
        even,
        at_even(whole.plate),
        None if command is None else at_even(command),
        whole.age[rows][new],
        whole.ball[rows][new],
    )
