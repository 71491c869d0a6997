"""A log of any rig, axis by axis: the tilt or its command, and the samples of the ball."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from controllers.arrays import Array, Mask
from twin.base.errors import LogError
from twin.identify.log_columns import AXIS_COLUMNS
from twin.identify.logs import Log
from twin.scenario.schema import Scenario

MAX_COMMAND_GAP_S = 0.5
"""Time in s without a row over which nothing is known of the command."""


@dataclass(frozen=True)
class EndStops:
    """Walls between which the ball rolls.

    Attributes:
        low: Position of the ball at the lower one, m; minus infinity if there is none.
        high: Position at the upper one, m; infinity if there is none.
        restitution: Speed after a bounce over the speed before.
        touches: When the ball touches one: begin and end in s, by rising time, shape (2, N).
    """

    low: float
    high: float
    restitution: float
    touches: Array


@dataclass(frozen=True)
class AxisLog:
    """One axis of a log.

    Attributes:
        time: When each command begins, s, shape (K,).
        tilt: The command or the measured angle, rad or counts, shape (K,).
        held: Whether it is held from row to row, as commands are.
        sampled: When each sample of the ball was taken, s, shape (M,).
        ball: The samples, m, shape (M,).
        across: Times in s, and how fast the ball goes along the other axis, m/s, shape (2, N);
            nowhere if friction is to act on this axis by itself.
        lever: How far above the plate's axis the ball is known to be as good as, m; None if it is
            not.
        stops: Its end stops; None without any.
        recordings: When each recording after the first begins where several are joined, s, rising,
            shape (R - 1,); their clocks may differ by an offset each.
        added: Tilts that were added to the tilt, each by as much as the log itself shows, (K,).
    """

    time: Array
    tilt: Array
    held: bool
    sampled: Array
    ball: Array
    across: Array = field(default_factory=lambda: np.zeros((2, 1)))
    lever: float | None = field(default=None, kw_only=True)
    stops: EndStops | None = field(default=None, kw_only=True)
    recordings: Array = field(default_factory=lambda: np.zeros(0), kw_only=True)
    added: tuple[Array, ...] = field(default=(), kw_only=True)

    @property
    def touching(self) -> Mask:
        """Samples of a ball that touches an end stop, shape (M,)."""
        if self.stops is None:
            return np.zeros(len(self.sampled), bool)
        begin, end = self.stops.touches
        latest = np.searchsorted(begin, self.sampled, "right") - 1
        return np.asarray((latest >= 0) & (self.sampled <= np.maximum.accumulate(end)[latest]))

    def between(self, begin: float, end: float) -> AxisLog:
        """This log with only the samples between two times in s."""
        return self._where((self.sampled >= begin) & (self.sampled < end))

    def without(self, begin: Array, seconds: float) -> AxisLog:
        """This log without the samples of so many seconds from each of some times in s on."""
        since = self.sampled - begin[:, None]
        return self._where(np.asarray(((since < 0) | (since >= seconds)).all(axis=0)))

    def tilt_at(self, time: Array) -> Array:
        """The tilt at times in s."""
        if not self.held:
            return np.interp(time, self.time, self.tilt)
        return self.tilt[np.maximum(np.searchsorted(self.time, time, "right") - 1, 0)]

    def clock_columns(self, time: Array) -> Array:
        """How a dead time may change over a log, next to its mean: columns of a regression.

        By an offset of the clock of each recording after the first, and by a drift that all
        recordings have in common, which grows with the time in each.

        Args:
            time: At which the dead time acts, s, shape (N,).

        Returns:
            One column for each offset that shows at these times, then the drift's, in s; each with
            zero mean, shape (N, C).
        """
        which = np.searchsorted(self.recordings, time, "right")
        there = which[:, None] == np.unique(which)
        since = time - there @ ((there.T @ time) / there.sum(axis=0))
        columns = np.column_stack((there[:, 1:], since))
        return columns - columns.mean(axis=0)

    def with_clock(self, drift: float) -> AxisLog:
        """This log with the clock of its samples slowed down, which is faster by a share."""
        first = self.time[0]
        sampled, at = (
            first + (each - first) / (1 + drift) for each in (self.sampled, self.across[0])
        )
        return replace(self, sampled=sampled, across=np.stack((at, self.across[1])))

    def _where(self, there: Mask) -> AxisLog:
        return replace(self, sampled=self.sampled[there], ball=self.ball[there])


@dataclass(frozen=True)
class AnyLog:
    """A log of any rig.

    Attributes:
        source: Its name in messages.
        axes: Axis to what the log has of it.
        unit: Unit of the tilt of each axis: rad or counts.
        notes: What was left out or assumed, in words.
    """

    source: str
    axes: Mapping[str, AxisLog]
    unit: Mapping[str, str]
    notes: tuple[str, ...]

    def on(self, scenario: Scenario, later: float = 0.0) -> Log:
        """As the rig of a scenario would have recorded it, a row every control period.

        The plate is where its drives take it of what was commanded, or as it was measured; an axis
        without columns stays at zero.

        Args:
            scenario: The rig: its period, ball, plate, drives, and tilt per command.
            later: Time in s by which the plate is to come later.

        Raises:
            LogError: If a command is in counts, or the ball was off that rig's plate.
        """
        if counted := [axis for axis, unit in self.unit.items() if unit != "rad"]:
            role = f"command_{AXIS_COLUMNS[counted[0]][1]}"
            raise LogError(
                f"{self.source}: {role}: in counts; the twin needs the plate's angle, a count's as "
                f"{role}=NAME:0.24deg"
            )
        half = np.divide(scenario.dimensions.screen, 2)
        first = next(iter(self.axes.values()))
        period = scenario.rig.period
        begin = max(float(first.sampled[0]), *(float(own.time[0]) for own in self.axes.values()))
        time = np.arange(math.ceil(begin / period), int(first.sampled[-1] / period) + 1) * period
        newest = np.searchsorted(first.sampled, time, side="right") - 1
        ball, plate, rate = np.zeros((3, len(time), 2))
        for axis, own in self.axes.items():
            k = list(AXIS_COLUMNS).index(axis)
            far = float(np.percentile(np.abs(own.ball), 99))
            if far > half[k]:
                low, high = np.percentile(own.ball, (1, 99))
                middle, elsewhere = (low + high) / 2, ""
                if high - low <= 2 * half[k]:
                    elsewhere = (
                        f", or its zero is not the plate's middle: it moves about {middle:.2g} m; "
                        "state the column's number in the middle of the plate, as "
                        f"{AXIS_COLUMNS[axis][0]}=NAME:mm@60"
                    )
                raise LogError(
                    f"{self.source}: {AXIS_COLUMNS[axis][0]}: reaches {far:.3g} m, the plate ends "
                    f"at {half[k]:.3g} m: a wrong unit, or a different rig (--on, plant.size)"
                    f"{elsewhere}"
                )
            ball[:, k] = own.ball[newest]
            if own.held:
                sent = own.tilt[np.maximum(np.searchsorted(own.time, time - later, "right") - 1, 0)]
                corner = scenario.plant.servo.bandwidth_hz
                stay = math.exp(-2 * math.pi * corner * period) if corner else 0.0
                behind = scipy.signal.lfilter([1 - stay], [1, -stay], sent, zi=[stay * sent[0]])[0]
                plate[:, k] = (1 + scenario.rig.cam_error_percent[k] / 100) * behind
                # a drive with rate commands takes the time between two commands for the way between
                count = max(1, round(float(np.median(np.diff(own.time))) / period))
                asked = scipy.signal.lfilter(np.full(count, 1 / count), [1.0], sent - sent[0])
            else:
                asked = plate[:, k] = np.interp(time - later, own.time, own.tilt)
            rate[:, k] = np.diff(asked, append=asked[-1:]) / period
        age = time - first.sampled[newest]
        seen = age < MAX_COMMAND_GAP_S / 2
        ball[~seen] = np.nan
        return Log(
            source=self.source,
            time=time,
            ball=ball,
            plate=plate,
            age=age,
            touched=seen,
            command=rate,
            model=scenario.plant.model,
            own_lag=0.0,
            grips=(0.0,),
            axes=1 if list(self.axes) == ["x"] else 2,
            walls=scenario.plant.reach,
        )
