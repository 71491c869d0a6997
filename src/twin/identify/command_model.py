"""Drive nonlinearities (dead band, play, slew) and lag applied to the commands of a log."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest

import numpy as np
from scipy.signal import lfilter, savgol_filter

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.identify.axis_logs import AxisLog
from twin.identify.least_squares import SampleWindows

DRIVE_EFFECTS = ("dead_band", "play", "slew")
"""Nonlinearities of a drive."""
PROFILED_EFFECTS = (*DRIVE_EFFECTS, "lever")
"""Parameters that are fitted value by value: the cost has no slope in those of a drive, and a lever
resembles a dead time."""
FINE_LAG_STEP_S = 0.002
"""Step of the lag in s."""
ACCELERATION_STEPS = (20, 4)
"""Fine steps over which the plate's acceleration is seen: measured, so that counts of an encoder
make none; and behind a lag, a step of the simulation."""
RATE_STEPS = 5
"""Fine steps to either side over which the rate of a measured angle is seen."""


def drive_path(time: Array, sent: Array, dead_band: float, slew: float) -> tuple[Array, Array]:
    """Where a drive goes, as corners of straight lines: times in s and places.

    It stands until the command is further off than the dead band, then goes all the way. Before
    the first command it stood at zero, as where a rig is switched on.

    Args:
        time: When each command begins, s, shape (K,).
        sent: The commands, shape (K,).
        dead_band: In their unit.
        slew: Seconds by unit of the commands.
    """
    place = goal = float(sent[0]) if abs(sent[0]) > dead_band else 0.0
    corners = []
    rows = zip(time.tolist(), sent.tolist(), np.diff(time, append=time[-1]).tolist(), strict=True)
    for now, wanted, left in rows:
        corners.append((now, place))
        if place != goal or abs(wanted - place) > dead_band:
            goal = wanted
        takes = slew * abs(goal - place)
        if takes > left:
            place += (goal - place) * left / takes
        elif place != goal:
            corners.append((now + takes, goal))
            place = goal
    return tuple(np.array(corners).T)


def apply_play(track: Array, half: float) -> Array:
    """Where a plate is behind a gap: it stands until the drive, at a track, has crossed it.

    Args:
        track: Of the drive, shape (K,).
        half: Half the width of the gap, in its unit.
    """
    low, high = track - half, track + half
    place = min(max(0.0, float(low[0])), float(high[0]))
    rises = np.concatenate(([True], np.diff(track) > 0))
    ends = np.append(np.flatnonzero(rises[1:] != rises[:-1]), len(track) - 1)
    # in a stretch in which the drive rises, the lower side of the gap moves the plate, and in the
    # next one, in which it does not, the upper side
    sides = low[ends[::2]].tolist(), high[ends[1::2]].tolist()
    begun = list[float]()
    for lower, upper in zip_longest(*sides, fillvalue=np.inf):
        begun.append(place)
        place = lower if lower > place else place
        begun.append(place)
        place = upper if upper < place else place
    held = np.repeat(begun[: len(ends)], np.diff(ends, prepend=-1))
    return np.minimum(np.maximum(held, low, out=low), high, out=low)


MAX_LEAD_S = 1.0
"""Time after a sample of the ball up to which commands are looked at: positions may be half a
second late by their clock."""
MAX_TRACK_VALUES = 3_000_000
"""Values of the tracks of a tilt that are kept for further simulations: 50 MB with integrals."""


def _remaining_share(lag: float) -> float:
    """Share of a deviation that a lag in s leaves after a fine step."""
    return float(np.exp(-FINE_LAG_STEP_S / lag)) if lag > 1e-4 else 0.0


def _interpolate(track: Array, place: Array) -> Array:
    """Values of a track at places of any shape, by straight lines; its ends are held."""
    place = np.minimum(np.maximum(place, 0.0), len(track) - 1.001)
    low = place.astype(np.intp)
    place -= low
    first = track.take(low)
    low += 1
    rise = track.take(low)
    rise -= first
    rise *= place
    rise += first
    return rise


class TiltHistory:
    """Tilt of the plate at any time, behind drives and their lag.

    Attributes:
        scale: Swing of the tilt, the unit of the fitted gain.
        tried: Those of ``PROFILED_EFFECTS`` that are possible: no drive lies between a measured
            angle and the ball, and a lever may be given.
    """

    def __init__(self, log: AxisLog, usual: float | None = None) -> None:
        """Of a log; ``usual`` is the swing of the log that was fitted, if a different one."""
        self.log = log
        self.scale = usual or float(np.std(log.tilt)) or 1.0
        # no sample shows what is commanded long after the last one
        last = np.max(log.sampled, initial=log.time[0]) + MAX_LEAD_S
        steps = int((min(log.time[-1], last) - log.time[0]) / FINE_LAG_STEP_S) + 2
        self.time = float(log.time[0]) + FINE_LAG_STEP_S * np.arange(steps)
        self.driven: dict[tuple[float, float], Array] = {}
        self.lagged: dict[tuple[float, ...], tuple[Array, Array]] = {}
        self.tried = DRIVE_EFFECTS * log.held + ("lever",) * (log.lever is None)

    def on(self, log: AxisLog) -> TiltHistory:
        """The history of another log in the same swings.

        It shares what was simulated if it has the same commands: a part of the samples.
        """
        found, own = TiltHistory(log, self.scale), self.log
        same = log.time is own.time and log.tilt is own.tilt and log.lever == own.lever
        if same and len(found.time) <= len(self.time):
            found.time, found.driven, found.lagged = self.time, self.driven, self.lagged
        return found

    def at(self, time: Array, lag: float, *drive: float) -> Array:
        """Tilt in swings behind a lag in s, at times in s of any shape.

        Args:
            time: Seconds.
            lag: Time constant.
            drive: Dead band of the drive, half the play behind it and its slew, in swings, and the
                lever in m beyond a given one, by which the plate's acceleration moves the ball;
                none for an ideal one.
        """
        return _interpolate(self._track(lag, drive)[0], self._place(time, lag))

    def integrate(self, time: Array, lag: float, *drive: float) -> Array:
        """Integral over time in s of what ``at`` returns, zero where the log begins."""
        track, covered = self._track(lag, drive)
        place = self._place(time, lag)
        found = _interpolate(covered, place)
        last = len(track) - 1.0
        if place.min(initial=0.0) < 0.0:  # held outside the log
            found += FINE_LAG_STEP_S * track[0] * np.minimum(place, 0.0)
        if place.max(initial=0.0) > last:
            found += FINE_LAG_STEP_S * track[-1] * np.maximum(place - last, 0.0)
        return found

    @cached_property
    def _rates(self) -> tuple[Array, Array]:
        """Times in s, and rates of the measured angle in swings per second; zero of commands."""
        if self.log.held:
            return self.time[:1], np.zeros(1)
        mean = np.pad(self._average_steps((0.0, 0.0)), RATE_STEPS, "edge")
        rates = (mean[2 * RATE_STEPS :] - mean[: -2 * RATE_STEPS]) / (
            2 * RATE_STEPS * FINE_LAG_STEP_S
        )
        return self.time[:-1] + FINE_LAG_STEP_S / 2, rates

    @cached_property
    def mean_square_rate(self) -> float:
        """Mean square of the rates of a measured angle, swings^2/s^2; zero of commands."""
        return float(np.mean(np.square(self._rates[1])))

    def rate_at(self, time: Array) -> Array:
        """Rate of a measured angle in swings per second, at times in s of any shape."""
        return np.interp(time, *self._rates)

    def _place(self, time: Array, lag: float) -> Array:
        """Fine steps from the beginning of the log to times in s.

        A mean stands in the middle of its step; what follows it slowly is right at its end.
        """
        stay = _remaining_share(lag)
        early = (
            FINE_LAG_STEP_S * (0.5 + stay / (1 - stay)) - lag if lag < 5 * FINE_LAG_STEP_S else 0.0
        )
        return (time + (early - self.time[1])) * (1 / FINE_LAG_STEP_S)

    def _track(self, lag: float, drive: tuple[float, ...]) -> tuple[Array, Array]:
        """Tilt behind a lag at every fine step, and its integral."""
        dead_band, play, slew, lever = drive or (0.0, 0.0, 0.0, 0.0)
        lever += self.log.lever or 0.0
        whole = (lag, dead_band, play, slew, lever)
        if whole not in self.lagged:
            if len(self.lagged) * len(self.time) > MAX_TRACK_VALUES:
                self.lagged.clear()
            stay, mean = _remaining_share(lag), self._average_steps((dead_band, slew))
            place = lfilter([1.0 - stay], [1.0, -stay], mean, zi=stay * mean[:1])[0]
            if play:
                place = apply_play(place, play)
            if lever:
                turns = ACCELERATION_STEPS[self.log.held]
                wide = np.pad(place, turns, "edge")
                bend = (wide[2 * turns :] - 2 * place + wide[: -2 * turns]) / (
                    turns * FINE_LAG_STEP_S
                ) ** 2
                place -= lever / BallPlate.gravity * bend
            covered = np.zeros_like(place)
            steps = np.add(place[1:], place[:-1], out=covered[1:])
            steps *= FINE_LAG_STEP_S / 2
            np.cumsum(steps, out=steps)
            self.lagged[whole] = place, covered
        return self.lagged[whole]

    def _average_steps(self, drive: tuple[float, float]) -> Array:
        """The tilt's mean in each fine step in swings, so that no time is rounded to a step.

        Args:
            drive: Dead band and slew.
        """
        if drive not in self.driven:
            self.driven[drive] = self._average_anew(drive)
        return self.driven[drive]

    def _average_anew(self, drive: tuple[float, float]) -> Array:
        """As ``_average_steps``, computed."""
        time, place = self.log.time, self.log.tilt / self.scale
        if self.log.held:
            time, place = drive_path(time, place, *drive)
        step, rise = np.diff(time), np.diff(place)
        covered = np.concatenate(([0.0], np.cumsum((place[:-1] + rise / 2) * step)))
        at = np.clip(np.searchsorted(time, self.time, "right") - 1, 0, len(step) - 1)
        since = np.minimum(self.time - time[at], step[at])
        bend = rise[at] / np.maximum(step[at], 1e-9) * since / 2
        return np.diff(covered[at] + since * (place[at] + bend)) / FINE_LAG_STEP_S


@dataclass(frozen=True, kw_only=True)
class DeadBandScan:
    """Constants of the regression over many dead bands.

    Attributes:
        step_s: Step of the simulation of the drives.
        min_sample_spacing_s: Smallest time between the samples that are used.
        dead_bands: Tried dead bands, in swings: a few thousandths decide when a drive moves.
    """

    step_s: float = 0.008
    min_sample_spacing_s: float = 0.04
    dead_bands: tuple[float, ...] = (
        0.0,
        *np.arange(0.02, 0.2, 0.0008).tolist(),
        *np.geomspace(0.2, 1.3, 500).tolist(),
    )


DEAD_BAND_SCAN = DeadBandScan()


def residual_by_dead_band(
    tilt: TiltHistory,
    windows: SampleWindows,
    delay: float,
    lag: float,
    scan: DeadBandScan = DEAD_BAND_SCAN,
) -> Array:
    """Residual of the ball's motion for drives with each of N dead bands, m^2, shape (N,).

    By regression: in each window a straight line, over all of them what gain, dead time, level,
    camber and friction add to it, the friction against the measured velocity.

    Args:
        tilt: The commands.
        windows: Positions of the ball.
        delay: A guess of the dead time in s.
        lag: A guess of the lag in s.
        scan: Constants of the regression.
    """
    step_s, bands = scan.step_s, np.array(scan.dead_bands)
    time, sent = tilt.log.time, tilt.log.tilt / tilt.scale
    seen = windows.weight[..., 0] > 0
    last = np.max(windows.begin[:, None] + windows.time, where=seen, initial=time[0]) - delay
    grid = np.arange(time[0], min(time[-1], last + 2 * step_s), step_s)
    place, row = np.where(abs(sent[0]) > bands, sent[0], 0.0), 0
    places = np.empty((len(grid), len(bands)))
    for k, stop in enumerate(np.searchsorted(time, grid, "right")):
        for wanted in sent[row:stop]:
            place = np.where(np.abs(wanted - place) > bands, wanted, place)
        row, places[k] = stop, place
    stay = np.exp(-step_s / max(lag, step_s))
    pushed = [lfilter([1.0 - stay], [1.0, -stay], places, axis=0)]
    for _ in range(2):
        pushed.append(step_s * np.cumsum(pushed[-1], axis=0))
    total = np.zeros((len(bands), 7, 7))
    for begin, t, x, weight in zip(
        windows.begin, windows.time, windows.ball[..., 0], windows.weight[..., 0], strict=True
    ):
        at = np.flatnonzero(weight > 0)
        at = at[:: max(1, round(scan.min_sample_spacing_s * len(at) / np.ptp(t[at])))]
        t, x = t[at], x[at]  # noqa: PLW2901
        step = np.gradient(t)[:, None]
        speed = np.gradient(savgol_filter(x, min(5, len(x) - 1 | 1), 1), t)
        forces = np.stack((np.sign(speed), x), axis=-1)
        moved = np.cumsum(np.cumsum(forces * step, axis=0) * step, axis=0)
        same = np.column_stack((t**2, moved, x))[..., None].repeat(len(bands), axis=-1)
        place = np.clip((begin + t - delay - grid[0]) / step_s, 0, len(grid) - 1.001)
        low = place.astype(int)
        part = (place - low)[:, None]
        each = [way[low] + part * (way[low + 1] - way[low]) for way in pushed]
        Z = np.concatenate((np.stack(each, axis=1), same), axis=1)  # noqa: N806
        Q = np.linalg.qr(np.stack((np.ones_like(t), t), axis=-1))[0]  # noqa: N806
        Z = np.moveaxis(Z - np.tensordot(Q @ Q.T, Z, 1), -1, 0)  # noqa: N806
        total += np.swapaxes(Z, -1, -2) @ Z
    size = np.sqrt(np.diagonal(total, axis1=-2, axis2=-1)) + 1e-12
    alike = total / size[:, :, None] / size[:, None] + 1e-9 * np.eye(7)
    # one over the diagonal of the inverse is what the others leave of the last
    return np.asarray(size[:, -1] ** 2 / np.linalg.inv(alike)[:, -1, -1])
