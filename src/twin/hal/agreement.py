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
AGREEMENT_CONDITIONS = (OPPOSITE, WRONG_RATIO, EXCHANGED)
"""How motors and plate may disagree; detected in that time where the plate turns at 10 deg/s."""

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
                if not span.width(4 + axis) <= allowed:
                    return self._named(axis)
        return None

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
