"""Whether motors and plate turn together according to the transmission between them.

The plate encoders close the loop: where one has a wrong sign, a wrong scale or the wrong axis, all
feedback of it makes the tilt larger. The motor encoders are an independent measurement.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array
from twin.hal.interface import LEVEL_REACTION, Condition, Severity, Transmission

_STOP_REACTION = "zero rate, then no torque"
_CHECK_WIRING = "check wiring, signs and scales with `ballplate doctor --move`, then run again"

OPPOSITE = Condition(
    "plate turns against its motor", Severity.STOP, 0.1, _STOP_REACTION, _CHECK_WIRING, periods=4
)
WRONG_RATIO = Condition(
    "plate ratio wrong", Severity.STOP, 0.5, _STOP_REACTION, _CHECK_WIRING, periods=4
)
EXCHANGED = Condition(
    "axes exchanged", Severity.STOP, 0.25, _STOP_REACTION, _CHECK_WIRING, periods=4
)
DRIVES_EXCHANGED = Condition("drives exchanged", Severity.LEVEL, 2.0, LEVEL_REACTION, _CHECK_WIRING)
UPHILL = Condition(
    "ball rolls against the tilt", Severity.LEVEL, 2.0, LEVEL_REACTION, _CHECK_WIRING
)
AGREEMENT_CONDITIONS = (OPPOSITE, WRONG_RATIO, EXCHANGED, DRIVES_EXCHANGED, UPHILL)
"""All conditions of motors, plate and ball. Motors against plate are detected in that time where it
turns at 10 deg/s, the ball against the plate where that is tilted by 1 deg."""


class Disagreement(NamedTuple):
    """A detected disagreement of motors and plate.

    Attributes:
        condition: The condition.
        axis: 0 for phi, 1 for theta.
        text: The measured angles and their explanation.
    """

    condition: Condition
    axis: int
    text: str


class _Span:
    """Smallest and largest value of some quantities since a moment."""

    __slots__ = ("high", "low")

    def __init__(self, values: tuple[float, ...]) -> None:
        self.low, self.high = list(values), list(values)

    def take(self, values: tuple[float, ...]) -> None:
        low, high = self.low, self.high
        for index, value in enumerate(values):
            if value < low[index]:
                low[index] = value
            elif value > high[index]:
                high[index] = value

    def width(self, index: int) -> float:
        return self.high[index] - self.low[index]


@dataclass(frozen=True, kw_only=True)
class MotionTest:
    """How the motion of motors and plate is compared.

    Attributes:
        max_difference: Share of the motion by which motor and plate may differ; a ratio wrong by a
            factor of 1.5 is 0.33.
        recent_s: Duration in s of the shorter of the two comparisons, which detects a part that
            slips later.
        proven_rad: Plate angle in rad through which both axes must have turned to be confirmed.
        scale_margin: Share of the motion by which a scale, a free parameter, must explain it better
            than a sign.
        memory_s: Duration in s of the motion by which a disagreement is explained.
    """

    max_difference: float = 0.2
    recent_s: float = 0.25
    proven_rad: float = float(np.radians(2.0))
    scale_margin: float = 0.15
    memory_s: float = 0.5


MOTION_TEST = MotionTest()


class Agreement:
    """Compares the angles of two motors and the plate, period by period.

    Both are compared as plate angles: a motor angle times the ratio at level, so that a nonlinear
    transmission is no disagreement. Their difference may vary by the lost motion between
    motor and plate (play, elastic parts, different sampling times) and by a share of the motion (an
    inaccurate transmission), since the first call and within a short time.

    Args:
        transmission: Plate angles to motor angles.
        lost: Plate angle in rad that may be lost between motor and plate, in both directions
            together.
        period: Control period in s.
        test: Constants of the comparison.
    """

    def __init__(
        self,
        transmission: Transmission,
        lost: float,
        period: float,
        test: MotionTest = MOTION_TEST,
    ) -> None:
        self._transmission = transmission
        self._lost, self._test = lost, test
        near = np.array([[1e-3, 0.0], [-1e-3, 0.0], [0.0, 1e-3], [0.0, -1e-3]])
        motor = np.array([transmission.motor(each[None])[0] for each in near])
        slope = (motor[0, 0] - motor[1, 0]) / 2e-3, (motor[2, 1] - motor[3, 1]) / 2e-3
        self._ratio = float(slope[0]), float(slope[1])
        self._recent_looks = max(2, round(test.recent_s / period))
        self._past: deque[tuple[float, ...]] = deque(maxlen=max(2, round(test.memory_s / period)))
        self._whole: _Span | None = None
        self._recent = self._next = _Span((0.0,) * 6)
        self._looks = 0
        self._still = [(math.nan, math.nan), (math.nan, math.nan)]
        """Plate angle of each axis, and motor angle when the plate last changed, rad."""

    def look(self, plate: Array, motor: Array) -> Disagreement | None:
        """Compare angles of one instant, both in rad, shape (2,); the disagreement, if any."""
        # shape (1, 2) has a faster look-up
        expected = self._transmission.motor(plate[None])[0].tolist()
        (p, q), (r, s) = expected, motor.tolist()
        of_phi, of_theta = self._ratio
        p, q, r, s = p / of_phi, q / of_theta, r / of_phi, s / of_theta
        now = p, q, r, s, r - p, s - q
        if not all(map(math.isfinite, now)):
            return None  # a transmission without numbers gives no command either
        self._past.append(now[:4])
        for axis in (0, 1):
            if now[axis] != self._still[axis][0]:
                self._still[axis] = now[axis], now[2 + axis]
        if self._whole is None:
            self._whole, self._recent, self._next = _Span(now), _Span(now), _Span(now)
        self._looks += 1
        if self._looks % self._recent_looks == 0:
            self._recent, self._next = self._next, _Span(now)
        self._whole.take(now)
        self._recent.take(now)
        self._next.take(now)
        for span in (self._whole, self._recent):
            motion = max(span.width(0), span.width(1), span.width(2), span.width(3))
            allowed = self._lost + self._test.max_difference * motion
            for axis in (0, 1):
                if not span.width(4 + axis) <= allowed and not self._frozen(now, axis):
                    return self._explain(axis)
        return None

    def _frozen(self, now: tuple[float, ...], axis: int) -> bool:
        """Whether the plate's angle has not changed while its motor turned.

        This is a frozen encoder, which has a condition of its own.
        """
        return abs(now[2 + axis] - self._still[axis][1]) > self._lost / 2

    @property
    def proven(self) -> bool:
        """Whether both axes have turned far enough to be confirmed."""
        span = self._whole
        return span is not None and min(span.width(2), span.width(3)) >= self._test.proven_rad

    def _explain(self, axis: int) -> Disagreement:
        """The best explanation of the last motion: wrong sign, wrong axis, else wrong scale."""
        past = np.array(self._past)
        off = past[:, 2 + axis] - past[:, axis]
        since = np.abs(off - off[-1])
        past = past[int(np.flatnonzero(since >= 0.9 * since.max())[-1]) :]
        past -= past[0]  # since they disagree
        plate, motor = past[:, :2], past[:, 2:]
        far = int(np.abs(past[:, axis::2]).max(axis=1).argmax())
        turned = np.degrees([motor[far, axis], plate[far, axis]])
        text = f"motor by {turned[0]:+.2f} deg of the plate, plate by {turned[1]:+.2f} deg"
        own = np.arange(2) == axis
        scale = float(plate[:, axis] @ motor[:, axis]) / max(
            float(motor[:, axis] @ motor[:, axis]), 1e-12
        )
        scale = max(scale, 0.0)
        explained = {
            "the other way": (OPPOSITE, motor * np.where(own, -1, 1)),
            "both the other way": (OPPOSITE, -motor),
            "by the other motor": (EXCHANGED, motor[:, ::-1]),
            "on a different scale": (WRONG_RATIO, motor * np.where(own, scale, 1.0)),
            "both on a different scale": (WRONG_RATIO, motor * scale),
        }
        margin = self._test.scale_margin
        misfits = {
            how: _misfit(plate, turn) + (margin if condition is WRONG_RATIO else 0.0)
            for how, (condition, turn) in explained.items()
        }
        how = min(misfits, key=lambda each: misfits[each])
        doubt = [
            each
            for each in explained
            if misfits[each] < misfits[how] + margin and explained[each][0] is not explained[how][0]
        ]
        words = " or ".join(("", *doubt))
        return Disagreement(explained[how][0], axis, f"{text}: {how}{words}")


def _misfit(plate: Array, motor: Array) -> float:
    """Share of a plate's motion that motors do not explain, (n, 2) each, 0 to 1.

    The larger of both axes.
    """
    left = np.abs(plate - motor).max(axis=0)
    motion = max(float(np.abs(plate).max()), float(np.abs(motor).max()), 1e-9)
    return float((left / motion).max())


@dataclass(frozen=True, kw_only=True)
class BallTest:
    """How the ball's motion is compared with the measured tilt.

    Attributes:
        window_s: Duration in s of the motion that is explained.
        delay_s: Approximate age in s of the ball's position: dead time of the screen and half a
            frame.
        min_positions: Number of positions from which the motion is explained.
        every_positions: Number of positions from one explanation to the next.
        min_motion_m: Root mean square in m of the motion that the tilt must have caused.
        min_unexplained: Share of that motion that the right explanation must leave.
        max_unexplained: Share of it that a wrong one may leave at most.
    """

    window_s: float = 1.0
    delay_s: float = 0.05
    min_positions: int = 20
    every_positions: int = 5
    min_motion_m: float = 0.003
    min_unexplained: float = 0.6
    max_unexplained: float = 0.1


BALL_TEST = BallTest()


class BallAgreement:
    """Whether the ball rolls in the direction of the measured tilt.

    Motors and plate encoders agree where both drives are exchanged with all their wires, or where
    motor and encoder of an axis both have the wrong sign. The ball shows it: within a window

        x = x_0 + v_0 t + k I_phi,  y = y_0 + w_0 t - k I_theta

    with the double integrals I of the measured angles over time and any k above 0, (5.3) for a
    small tilt. A different explanation is accepted only where this one leaves most of the motion,
    and the other one almost nothing.

    Args:
        period: Control period in s.
        test: Constants of the comparison.
    """

    def __init__(self, period: float, test: BallTest = BALL_TEST) -> None:
        self._period, self._test = period, test
        self._rate, self._way = [0.0, 0.0], [0.0, 0.0]
        self._ways: deque[tuple[float, float]] = deque(maxlen=max(1, round(test.delay_s / period)))
        self._seen: deque[tuple[float, ...]] = deque()
        self._place = (math.nan, math.nan)
        self._time = 0.0
        self._new = 0

    def look(self, ball: Array, plate: Array, touched: bool) -> tuple[Condition, str] | None:
        """Process a period; the condition of a disagreement and its text, if there is one.

        Args:
            ball: Measured position of the ball in m, shape (2,).
            plate: Measured plate angles (phi, theta) in rad, shape (2,).
            touched: Whether the screen detects the ball.
        """
        test = self._test
        self._time += self._period
        angles, place = plate.tolist(), tuple(ball.tolist())
        for axis in (0, 1):
            self._rate[axis] += self._period * angles[axis]
            self._way[axis] += self._period * self._rate[axis]
        self._ways.append((self._way[0], self._way[1]))
        if not touched or not all(map(math.isfinite, (*angles, *place))):
            self._seen.clear()
            return None
        if place == self._place:
            return None
        self._place = place
        self._seen.append((self._time, *place, *self._ways[0]))
        while self._time - self._seen[0][0] > test.window_s:
            self._seen.popleft()
        self._new += 1
        if self._new % test.every_positions or len(self._seen) < test.min_positions:
            return None
        return self._explain()

    def _explain(self) -> tuple[Condition, str] | None:
        seen, test = np.array(self._seen), self._test
        time = seen[:, 0] - seen[:, 0].mean()
        moved = seen[:, 1:] - seen[:, 1:].mean(axis=0)
        moved -= np.outer(time, time @ moved) / float(time @ time)
        x, y, phi, theta = moved.T
        whole = float(x @ x + y @ y)
        if whole < len(seen) * test.min_motion_m**2:
            return None

        def left(by_x: Array, by_y: Array) -> float:
            """Share of the motion that accelerations of this shape do not explain."""
            size = float(by_x @ by_x + by_y @ by_y)
            k = max(0.0, float(x @ by_x + y @ by_y)) / max(size, 1e-30)
            return float(np.square(x - k * by_x).sum() + np.square(y - k * by_y).sum()) / whole

        if left(phi, -theta) < test.min_unexplained:
            return None
        others = {
            "phi and theta are exchanged": (DRIVES_EXCHANGED, left(theta, -phi)),
            "phi has the other sign": (UPHILL, left(-phi, -theta)),
            "theta has the other sign": (UPHILL, left(phi, theta)),
            "phi and theta have the other sign": (UPHILL, left(-phi, theta)),
        }
        words = min(others, key=lambda each: others[each][1])
        condition, share = others[words]
        if share > test.max_unexplained:
            return None
        rival = min(each for other, each in others.values() if other is not condition)
        whole_window = seen[-1, 0] - seen[0, 0] >= 0.9 * test.window_s
        if rival < 2 * test.max_unexplained and not whole_window:
            return None  # more motion distinguishes them
        return condition, f"the ball rolls as if {words}: the drives, or the touch screen's axes"
