"""Whether motors and plate turn together as the transmission between them says.

The plate encoders close the loop: where one counts the wrong way, on another scale or for the other
axis, every answer that believes it makes the tilt larger. The motor encoders are a second witness.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array
from twin.hal.interface import Condition, Severity, Transmission

_STOPPED = "zero rate, then no torque"
_CHECK = "check wiring, signs and scales with `ballplate doctor --move`, then run again"

OPPOSITE = Condition(
    "plate turns against its motor", Severity.STOP, 0.1, _STOPPED, _CHECK, periods=4
)
WRONG_RATIO = Condition("plate ratio wrong", Severity.STOP, 0.5, _STOPPED, _CHECK, periods=4)
EXCHANGED = Condition("axes exchanged", Severity.STOP, 0.25, _STOPPED, _CHECK, periods=4)
_LEVELLED = "level the plate, then hold"
DRIVES_EXCHANGED = Condition("drives exchanged", Severity.LEVEL, 2.0, _LEVELLED, _CHECK)
UPHILL = Condition("ball rolls against the tilt", Severity.LEVEL, 2.0, _LEVELLED, _CHECK)
AGREEMENT_CONDITIONS = (OPPOSITE, WRONG_RATIO, EXCHANGED, DRIVES_EXCHANGED, UPHILL)
"""How motors, plate and ball may disagree. Motors against plate are detected in that time where it
turns at 10 deg/s, the ball against the plate where that is tilted by 1 deg."""

AXES = ("phi", "theta")


class Disagreement(NamedTuple):
    """That motors and plate do not turn together.

    Attributes:
        condition: In which way.
        axis: 0 for phi, 1 for theta.
        text: What was seen, in words and numbers.
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


class Agreement:
    """Compares how far two motors and the plate have turned, period by period.

    Both are compared as plate angles, that of a motor by the ratio at level, so that a transmission
    that is not linear is no disagreement. Their difference may vary by what is lost between motor
    and plate (play, elastic parts, what is sampled at another time) and by a share of the motion (a
    transmission that is known badly), since the first look and within the last moments.

    Args:
        transmission: Plate angles to motor angles.
        lost: Plate angle in rad that may be lost between motor and plate, either way together.
        period: Control period in s.
    """

    SHARE = 0.2
    """Share of the motion by which motor and plate may differ; a ratio off by 1.5 is 0.33."""
    MOMENT = 0.25
    """Duration in s of the shorter of the two comparisons, which sees a part that slips later."""
    PROVEN = float(np.radians(2.0))
    """Plate angle in rad that both axes must have turned through to be known to be right."""
    FREE = 0.15
    """Share of the motion by which a scale, which is free, must explain it better than a sign."""
    MEMORY = 0.5
    """Duration in s of the motion by which a disagreement is given its name."""

    def __init__(self, transmission: Transmission, lost: float, period: float) -> None:
        self._transmission = transmission
        self._lost = lost
        near = np.array([[1e-3, 0.0], [-1e-3, 0.0], [0.0, 1e-3], [0.0, -1e-3]])
        motor = np.array([transmission.motor(each[None])[0] for each in near])
        slope = (motor[0, 0] - motor[1, 0]) / 2e-3, (motor[2, 1] - motor[3, 1]) / 2e-3
        self._ratio = float(slope[0]), float(slope[1])
        self._moment = max(2, round(self.MOMENT / period))
        self._past: deque[tuple[float, ...]] = deque(maxlen=max(2, round(self.MEMORY / period)))
        self._whole: _Span | None = None
        self._recent = self._next = _Span((0.0,) * 6)
        self._looks = 0
        self._still = [(math.nan, math.nan), (math.nan, math.nan)]
        """Plate angle of each axis, and motor angle when the plate last changed, rad."""

    def look(self, plate: Array, motor: Array) -> Disagreement | None:
        """Compare angles of one instant, both in rad, shape (2,); the disagreement, if any."""
        # shape (1, 2) is looked up by the fast path
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
        if self._looks % self._moment == 0:
            self._recent, self._next = self._next, _Span(now)
        self._whole.take(now)
        self._recent.take(now)
        self._next.take(now)
        for span in (self._whole, self._recent):
            motion = max(span.width(0), span.width(1), span.width(2), span.width(3))
            allowed = self._lost + self.SHARE * motion
            for axis in (0, 1):
                if not span.width(4 + axis) <= allowed and not self._frozen(now, axis):
                    return self._named(axis)
        return None

    def _frozen(self, now: tuple[float, ...], axis: int) -> bool:
        """Whether the plate's angle has stayed the very same while its motor turned.

        That is a frozen encoder, which has a condition of its own.
        """
        return abs(now[2 + axis] - self._still[axis][1]) > self._lost / 2

    @property
    def proven(self) -> bool:
        """Whether both axes have turned far enough to be known to be right."""
        span = self._whole
        return span is not None and min(span.width(2), span.width(3)) >= self.PROVEN

    def _named(self, axis: int) -> Disagreement:
        """What explains the last motion best: other way, other axis; else another scale."""
        past = np.array(self._past)
        off = past[:, 2 + axis] - past[:, axis]
        since = np.abs(off - off[-1])
        past = past[int(np.flatnonzero(since >= 0.9 * since.max())[-1]) :]
        past -= past[0]  # since they have not agreed
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
            "on another scale": (WRONG_RATIO, motor * np.where(own, scale, 1.0)),
            "both on another scale": (WRONG_RATIO, motor * scale),
        }
        misfits = {
            how: _misfit(plate, turn) + (self.FREE if condition is WRONG_RATIO else 0.0)
            for how, (condition, turn) in explained.items()
        }
        how = min(misfits, key=lambda each: misfits[each])
        doubt = [
            each
            for each in explained
            if misfits[each] < misfits[how] + self.FREE
            and explained[each][0] is not explained[how][0]
        ]
        words = " or ".join(("", *doubt))
        return Disagreement(explained[how][0], axis, f"{text}: {how}{words}")


def _misfit(plate: Array, motor: Array) -> float:
    """What motors leave unexplained of a plate's motion, (n, 2) each: 0 for nothing, 1 for all.

    The larger of both axes.
    """
    left = np.abs(plate - motor).max(axis=0)
    motion = max(float(np.abs(plate).max()), float(np.abs(motor).max()), 1e-9)
    return float((left / motion).max())


class BallAgreement:
    """Whether the ball rolls where the plate is measured to be tilted.

    Motors and plate encoders agree where both drives are exchanged with all that is wired to them,
    or where motor and encoder of an axis both count the wrong way. The ball tells: within a window

        x = x_0 + v_0 t + k I_phi,  y = y_0 + w_0 t - k I_theta

    with the double integrals I of the measured angles over time and any k above 0, (5.3) for a
    plate that is tilted by little. Another explanation is believed only where this one leaves most
    of the motion, and the other next to nothing.

    Args:
        period: Control period in s.
    """

    WINDOW = 1.0
    """Duration in s of the motion that is explained."""
    DELAY = 0.05
    """Age in s of the ball's position, about: dead time of the screen and half a frame."""
    SAMPLES = 20
    """Number of positions from which the motion is explained."""
    EVERY = 5
    """Number of positions from one explanation to the next."""
    MOVED = 0.003
    """Size in m, as root of the mean square, of the motion that the tilt must have made."""
    UNEXPLAINED, LEFT = 0.6, 0.1
    """Share of that motion that the right explanation must leave, and another may at most."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._rate, self._way = [0.0, 0.0], [0.0, 0.0]
        self._ways: deque[tuple[float, float]] = deque(maxlen=max(1, round(self.DELAY / period)))
        self._seen: deque[tuple[float, ...]] = deque()
        self._place = (math.nan, math.nan)
        self._time = 0.0
        self._new = 0

    def look(self, ball: Array, plate: Array, touched: bool) -> tuple[Condition, str] | None:
        """Take in a period; what disagrees and what was seen, in words, if anything does.

        Args:
            ball: Measured position of the ball in m, shape (2,).
            plate: Measured plate angles (phi, theta) in rad, shape (2,).
            touched: Whether the ball is felt.
        """
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
        while self._time - self._seen[0][0] > self.WINDOW:
            self._seen.popleft()
        self._new += 1
        if self._new % self.EVERY or len(self._seen) < self.SAMPLES:
            return None
        return self._explained()

    def _explained(self) -> tuple[Condition, str] | None:
        seen = np.array(self._seen)
        time = seen[:, 0] - seen[:, 0].mean()
        moved = seen[:, 1:] - seen[:, 1:].mean(axis=0)
        moved -= np.outer(time, time @ moved) / float(time @ time)
        x, y, phi, theta = moved.T
        whole = float(x @ x + y @ y)
        if whole < len(seen) * self.MOVED**2:
            return None

        def left(by_x: Array, by_y: Array) -> float:
            """Share of the motion that is left by accelerations of this shape."""
            size = float(by_x @ by_x + by_y @ by_y)
            k = max(0.0, float(x @ by_x + y @ by_y)) / max(size, 1e-30)
            return float(np.square(x - k * by_x).sum() + np.square(y - k * by_y).sum()) / whole

        if left(phi, -theta) < self.UNEXPLAINED:
            return None
        others = {
            "phi and theta are exchanged": (DRIVES_EXCHANGED, left(theta, -phi)),
            "phi has the other sign": (UPHILL, left(-phi, -theta)),
            "theta has the other sign": (UPHILL, left(phi, theta)),
            "phi and theta have the other sign": (UPHILL, left(-phi, theta)),
        }
        words = min(others, key=lambda each: others[each][1])
        condition, share = others[words]
        if share > self.LEFT:
            return None
        rival = min(each for other, each in others.values() if other is not condition)
        if rival < 2 * self.LEFT and seen[-1, 0] - seen[0, 0] < 0.9 * self.WINDOW:
            return None  # more motion tells them apart
        return condition, f"the ball rolls as if {words}: the drives, or the touch screen's axes"
