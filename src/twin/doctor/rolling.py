"""The directions of both axes, shown by the ball: tilt a little, see where it rolls, brake it.

No encoder is needed, and what encoders cannot show is seen: an axis of which drive and encoder
both have the wrong sign, two axes that are exchanged, a picture that is turned or mirrored. The
ball is braked by the opposite tilt, whatever the signs are, and rolls back in the second half.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array
from twin.base.errors import RigError
from twin.devices.rig import HardwareRig
from twin.doctor.check import CheckResult, fail_check, pass_check
from twin.hal.interface import AXIS_NAMES


@dataclass(frozen=True, kw_only=True)
class RollTest:
    """How the ball is made to roll, and which direction counts as the right one.

    Attributes:
        ramp_rad_s: Rate in rad/s at which an axis is tilted until the ball rolls.
        max_tilt_rad: Largest tilt in rad; most balls roll from 0.3 to 1 deg on.
        rolled_m: Distance in m after which the ball counts as rolling.
        middle_share: Share of the operating area within which the ball must be put.
        gain_per_s: Commanded rate per error of the plate angle, 1/s.
        max_rate_rad_s: Largest commanded rate, rad/s.
        speed_s: Time in s over which the speed of the ball is measured.
        brake_s: Longest time in s of the opposite tilt.
        rest_s: Longest time in s on a level plate after it, at least a quarter of it.
        rest_speed_m_s: Speed in m/s below which the ball counts as resting.
        max_turned_deg: Angle in deg by which the ball's direction may differ from the right one.
    """

    ramp_rad_s: float = math.radians(1.2)
    max_tilt_rad: float = math.radians(4.0)
    rolled_m: float = 0.008
    middle_share: float = 0.35
    gain_per_s: float = 6.0
    max_rate_rad_s: float = math.radians(20.0)
    speed_s: float = 0.1
    brake_s: float = 1.5
    rest_s: float = 2.0
    rest_speed_m_s: float = 0.01
    max_turned_deg: float = 20.0


ROLL_TEST = RollTest()
RIGHT_DIRECTIONS = {
    "phi": (np.array([1.0, 0.0]), "larger x", "smaller x"),
    "theta": (np.array([0.0, -1.0]), "smaller y", "larger y"),
}
"""Where a positive angle lets the ball roll, in x and y; the same and the opposite in words."""
SIGN_ADVICE = {
    "phi": "if the end at larger x went down first, negate x of the screen, else the command "
    "and encoder of phi",
    "theta": "if the end at larger y went up first, negate y of the screen, else the command "
    "and encoder of theta",
}


def roll(
    rig: HardwareRig, patience: float = 0.0, test: RollTest = ROLL_TEST
) -> Iterator[CheckResult]:
    """Check of each axis that the ball rolls in the right direction.

    Args:
        rig: The rig, switched on, not started.
        patience: Longest time in s that a ball at rest in the middle is waited for.
        test: Constants of the motion.

    Raises:
        RigError: The rig stopped: a device reports a fault, or the ball was lost.
    """
    motion, middle = _Motion(rig, test), test.middle_share * np.array(rig.supervisor.limits.area)
    if not motion.wait_for_ball(middle, max(patience, test.rest_s)):
        at = "not at rest there: x {:+.0f}, y {:+.0f} mm".format(*1e3 * motion.place)
        seen = at if motion.seen else "no ball is seen"
        x, y = 1e3 * middle
        yield fail_check("ball", seen, f"put it within {x:.0f} x {y:.0f} mm of the middle")
        return
    rig.start()
    for axis, name in enumerate(AXIS_NAMES[: rig.supervisor.axes]):
        yield _direction(name, motion.tilt(axis, 1), motion.tilt(axis, -1), test)


def _direction(
    name: str, up: tuple[Array, float], down: tuple[Array, float], test: RollTest
) -> CheckResult:
    """The result for an axis.

    Args:
        name: The axis.
        up: How the ball moved at a positive tilt, in m, shape (2,), and the tilt in rad.
        down: The same for a negative one.
        test: Which direction is right.
    """
    what, (right, there, back) = f"ball by {name}", RIGHT_DIRECTIONS[name]
    tilts = math.degrees(up[1]), math.degrees(down[1])
    if not any(np.hypot(*moved) >= test.rolled_m for moved, _ in (up, down)):
        seen = f"it did not roll at {tilts[0]:+.1f} and {tilts[1]:+.1f} deg"
        return fail_check(what, seen, "is it the ball that is seen? does the plate tilt at all?")
    rolled = up[0] - down[0]
    seen = "by {:+.1f}, {:+.1f} mm at {:+.1f} deg, {:+.1f}, {:+.1f} mm at {:+.1f} deg".format(
        *1e3 * up[0], tilts[0], *1e3 * down[0], tilts[1]
    )
    if np.hypot(*rolled) < test.rolled_m:
        seen = f"it rolled {seen}: to the same side both times"
        return fail_check(what, seen, "level the plate, so that the ball rests on it")
    across = right[0] * rolled[1] - right[1] * rolled[0]
    turned = math.degrees(math.atan2(across, right @ rolled))
    if abs(turned) <= test.max_turned_deg:
        return pass_check(what, f"rolls to {there} at a positive angle: {seen}")
    if abs(turned) >= 180 - test.max_turned_deg:
        seen = f"rolls to {back} at a positive angle: {seen}"
        return fail_check(what, seen, SIGN_ADVICE[name])
    seen = f"rolls {abs(turned):.0f} deg off its direction: {seen}"
    if abs(abs(turned) - 90) <= test.max_turned_deg:
        advice = "exchange the drives of phi and theta, or the screen's x and y"
    else:
        advice = "turn the screen, or its picture, until x and y are along the plate's axes"
    return fail_check(what, seen, advice)


class _Motion:
    """The plate, tilted about one axis at a time, and the ball on it.

    Args:
        rig: The rig, switched on.
        test: Constants of the motion.
    """

    def __init__(self, rig: HardwareRig, test: RollTest) -> None:
        self._rig, self._test = rig, test
        self._half = self._periods(test.speed_s)
        self._places = np.full((2 * self._half, 2), math.nan)
        """Measured places of the ball in m, period by period, the newest last."""
        self._plate = rig.read().y[0, 1::2]
        self.seen = False
        """Whether the ball is seen now; if it is not, its place is the last one known."""

    @property
    def place(self) -> Array:
        """Where the ball was last, the mean over ``speed_s``, m, shape (2,)."""
        return self._places[self._half :].mean(axis=0)

    @property
    def velocity(self) -> Array:
        """Velocity of the ball in m/s, shape (2,), between two means of its place; NaN at first."""
        return (self.place - self._places[: self._half].mean(axis=0)) / self._test.speed_s

    def wait_for_ball(self, middle: Array, seconds: float) -> bool:
        """Whether the ball comes to rest within a rectangle, half sides in m, in a time in s.

        The plate is held: the rig is not started.
        """
        since, watched = 0, self._periods(0.25 * self._test.rest_s)
        for _ in range(self._periods(seconds)):
            self._exchange(np.zeros(2))
            there = self.seen and (np.abs(self.place) <= middle).all() and self.rests
            since = since + 1 if there else 0
            if since >= watched:
                return True
        return False

    @property
    def rests(self) -> bool:
        """Whether the ball is slow enough to count as resting."""
        return bool(np.hypot(*self.velocity) < self._test.rest_speed_m_s)

    def rest(self) -> None:
        """Level the plate, and wait until the ball rests, not for ever."""
        begun = self._periods(0.25 * self._test.rest_s)
        self._turn(
            lambda _: np.zeros(2),
            self._test.rest_s,
            lambda period: period >= begun and self.rests,
        )

    def _exchange(self, rate: Array) -> None:
        """A period at plate rates in rad/s, shape (2,)."""
        self._rig.write(rate[None])
        self._rig.wait()
        measurement = self._rig.read()
        y, self.seen = measurement.y[0], bool(measurement.touched[0])
        self._plate = y[1::2]
        self._places[:-1] = self._places[1:]
        self._places[-1] = y[0::2]

    def tilt(self, axis: int, sign: int) -> tuple[Array, float]:
        """Tilt until the ball rolls, brake it by the opposite tilt, and let it rest.

        Args:
            axis: 0 for phi, 1 for theta.
            sign: Of the tilt.

        Returns:
            How the ball moved, in m, shape (2,), and at which tilt, in rad.
        """
        test, start, unit = self._test, self.place, sign * (np.arange(2) == axis)
        ramp = test.ramp_rad_s * self._rig.period

        def rolls(_: int) -> bool:
            return bool(np.hypot(*(self.place - start)) >= test.rolled_m)

        periods = self._turn(
            lambda period: ramp * period * unit, test.max_tilt_rad / test.ramp_rad_s, rolls
        )
        moved, tilt = self.place - start, ramp * periods
        if rolls(periods):

            def braked(_: int) -> bool:
                return bool(self.velocity @ moved <= 0)

            self._turn(lambda _: -tilt * unit, test.brake_s, braked)
        self.rest()
        return moved, sign * tilt

    def _periods(self, seconds: float) -> int:
        return max(1, round(seconds / self._rig.period))

    def _turn(
        self, goal: Callable[[int], Array], seconds: float, done: Callable[[int], bool]
    ) -> int:
        """Follow plate angles in rad, by period, for a time in s or until done; the periods.

        Raises:
            RigError: The rig stopped.
        """
        test, periods = self._test, self._periods(seconds)
        for period in range(periods):
            rate = test.gain_per_s * (goal(period) - self._plate)
            self._exchange(np.clip(rate, -test.max_rate_rad_s, test.max_rate_rad_s))
            if not self._rig.supervisor.all_running:
                raise RigError(self._rig.supervisor.reason[0])
            if done(period):
                return period
        return periods
