"""What plate and drives do, from commanded rates and measured angles: rate, swing and lag.

All calculations are by components: plain numbers for one rig, which is several times faster, and
arrays with one entry per rig for several.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from controllers.arrays import Arithmetic
from controllers.ballplate import LONGEST_LAG


class SlowPlate:
    """Angle and rate about one axis from the commanded rate, with a bias from the encoder.

    phi' = w + b with the commanded rate w, as the drives follow it. Angle and bias b are corrected
    by the measured angle with two equal poles. The measured rate would feed the resonance of plate
    and spring (13 and 19 Hz) back; the commanded one alone drifts, as disturbances of the motors
    accumulate.

    Args:
        pole: Both poles of the error, as a rate in 1/s.
        period: Control period in s.
        lag: Time constant in s with which drives follow the commanded rate; 0 for at once.
        angle: Initial angle, rad, a component.
        rate: Initial rate, rad/s, a component.
    """

    def __init__(self, pole: float, period: float, lag: float, angle: Any, rate: Any) -> None:
        self.angle = angle
        self.requested = rate
        """Plate rate commanded last, rad/s."""
        self.commanded = rate
        """The rate of the drives that follow it, rad/s."""
        self.left: Any = math.exp(-period / lag) if lag else 0.0
        """Share of a change of the commanded rate that the drives still lack after a period."""
        self.bias = 0 * angle
        """Rate of the plate beyond that, rad/s: play of the drives, disturbed motors."""
        self.error: Any = 0 * angle
        """The last measured angle less the expected one, rad."""
        self._period = period
        self.set_pole(pole)

    def set_pole(self, pole: Any) -> None:
        """Set both poles of the error, as a rate in 1/s."""
        self._gain = 2 * pole * self._period, pole * pole * self._period

    def correct(self, measured: Any) -> tuple[Any, Any]:
        """Angle in rad and rate in rad/s, corrected by the measured angle in rad."""
        self.error = error = measured - self.angle
        self.angle = self.angle + self._gain[0] * error
        self.bias = self.bias + self._gain[1] * error
        return self.angle, self.commanded + self.bias

    def predict(self, u: Any) -> None:
        """One period under the applied acceleration in rad/s^2."""
        T, before = self._period, self.commanded
        self.requested = self.requested + T * u
        self.commanded = self.requested + self.left * (before - self.requested)
        self.angle = self.angle + T * (before + self.commanded) / 2 + T * self.bias


@dataclass(frozen=True, kw_only=True)
class SwingTest:
    """Limits of the detection of a plate that swings on its drive train.

    Attributes:
        amplitude_rad: Smallest amplitude of a swing.
        max_half_swing_s: Longest time of half a swing.
        half_swings: Number of consecutive half swings above which the plate swings.
    """

    amplitude_rad: float = 0.003
    max_half_swing_s: float = 0.14
    half_swings: int = 8


SWING_TEST = SwingTest()


class SwingingPlate:
    """Whether a plate swings on a soft drive train, together with the feedback that measures it.

    A plate on a soft drive train swings at a few hertz. Feedback of its measured angle is too late
    for that and keeps it swinging. It is detected by the error of the measured angle from the
    commanded one: one half swing after the other, to either side.

    Args:
        period: Control period in s.
        none: 0 for each rig, a component.
        by: Arithmetic of components.
        test: Constants of the test.
    """

    def __init__(
        self, period: float, none: Any, by: Arithmetic, test: SwingTest = SWING_TEST
    ) -> None:
        self._period, self._by, self._test = period, by, test
        self._axes = [(none + 1.0, none, none)] * 2
        """Side of each axis, time in s since it changed, number of half swings so far."""
        self.found = none > 0
        """Whether the plate swings, or did."""

    def correct(self, errors: Sequence[Any]) -> bool:
        """Process measured angles less the expected ones, rad; whether a new rig swings."""
        by, found, test = self._by, self.found, self._test
        for axis, error in enumerate(errors):
            side, since, halves = self._axes[axis]
            turned = error * side < -test.amplitude_rad
            counted = by.where(since < test.max_half_swing_s, halves + 1.0, 1.0)
            halves = by.where(turned, counted, halves)
            since = by.where(turned, 0.0, since + self._period)
            self._axes[axis] = by.where(turned, -side, side), since, halves
            found = found | (halves > test.half_swings)
        more = bool(by.any(found != self.found))
        self.found = found
        return more


LAG_NAME = "plate_lag"
"""Name of the quantity of a law that counts the lag of the drives."""


@dataclass(frozen=True, kw_only=True)
class LagSearch:
    """Constants of the estimate of the drives' lag.

    Attributes:
        max_play_rad: Angle in rad after a reversal of a drive within which its play, at most
            0.3 deg, may be crossed.
        rate_change_window_s: Time in s over which changes of the plate's rate are compared with its
            angle.
        plate_lag_s: Lag in s of a plate with drives that have none.
        plate_lag_std_s: Lag in s beyond ``plate_lag_s`` that may have other causes; an estimate
            below it counts as none, one above twice it counts in full.
        min_rate_change_sum: Sum of the squares of changes of the rate, (rad/s)^2, that is added to
            the denominator, so that little motion gives no lag.
        max_rate_change_sum: Sum in (rad/s)^2 beyond which old changes are forgotten.
        max_lag_s: Largest estimate in s.
    """

    max_play_rad: float = 0.0052
    rate_change_window_s: float = 0.03
    plate_lag_s: float = 0.0025
    plate_lag_std_s: float = 0.004
    min_rate_change_sum: float = 0.02
    max_rate_change_sum: float = 4.0
    max_lag_s: float = LONGEST_LAG


LAG_SEARCH = LagSearch()


class DriveLag:
    """Lag of the drives from the difference of the commanded and the measured plate angle.

    With a rate a' that follows the commanded w, a'' = (w - a') / T, the integral of w exceeds the
    angle by T a' and a constant. T is estimated by least squares, from the changes of both over
    hundredths of a second along both axes, while the plate turns in one direction beyond its play.
    The lag of the mechanism itself is subtracted, and a lag below ``plate_lag_std_s`` is none.

    Args:
        period: Control period in s.
        state: Components of the initial ``State``.
        by: Arithmetic of components.
        search: Constants of the search.
    """

    def __init__(
        self, period: float, state: Sequence[Any], by: Arithmetic, search: LagSearch = LAG_SEARCH
    ) -> None:
        self._period, self._by, self._search = period, by, search
        none = 0.0 * state[2]
        self._sent = list(state[2::4])
        """Angles of drives without any lag, rad."""
        self._followed = list(state[3::4])
        """Rates of drives with the estimated lag, rad/s."""
        self._axes = [(none, none, none)] * 2
        """Angle since an axis reversed, slow means of its difference and of its rate."""
        self._squares = self._products = none
        self._kept = none + 1.0
        self.lag = self.left = none
        """T, s, and the share of a change of the commanded rate that is lacking after a period."""

    def give_up(self, swings: Any) -> None:
        """Set the lag to none where the plate swings, which looks like a lag and is not."""
        self._kept = self._by.where(swings, 0.0, 1.0)

    def correct(self, measured: Sequence[Any]) -> None:
        """Process the measured angles in rad."""
        by, search = self._by, self._search
        share = self._period / search.rate_change_window_s
        squares, products = self._squares, self._products
        for axis, (turned, slow_behind, slow_rate) in enumerate(self._axes):
            r, behind = self._followed[axis], self._sent[axis] - measured[axis]
            way = by.where(turned * r < 0, 0.0, turned) + self._period * r
            engaged = abs(way) > search.max_play_rad
            b, c = engaged * (behind - slow_behind), engaged * (r - slow_rate)
            squares, products = squares + c * c, products + b * c
            self._axes[axis] = way, behind - (1 - share) * b, r - (1 - share) * c
        forget = search.max_rate_change_sum / by.most(squares, search.max_rate_change_sum)
        self._squares, self._products = squares, products = forget * squares, forget * products
        found = products / (squares + search.min_rate_change_sum) - search.plate_lag_s
        sure = by.least(found, 2 * (found - search.plate_lag_std_s))
        self.lag = lag = self._kept * by.least(by.most(sure, 0.0), search.max_lag_s)
        # exp(-period / lag), by a formula with the same bits for one rig and in any batch
        self.left = (lag > self._period) * (2 * lag - self._period) / (2 * lag + self._period)

    def predict(self, rates: Sequence[Any]) -> None:
        """One period at commanded rates in rad/s."""
        self._sent = [a + self._period * w for a, w in zip(self._sent, rates, strict=True)]
        followed = zip(self._followed, rates, strict=True)
        self._followed = [w + self.left * (r - w) for r, w in followed]
