"""How a screen is mounted, in words a person can check: size, sides, turn, place of its centre."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, degrees, hypot, pi
from typing import Any, Self

from twin.devices.lumio.calibration import Calibration


@dataclass(frozen=True)
class Mounting:
    """What a calibration says of the screen.

    Attributes:
        size: Sides of the sensing area along the plate's x and y, m.
        swapped: Whether the screen's first axis runs along the plate's y.
        mirrored_x: Whether the screen's position along the plate's x counts backwards.
        mirrored_y: The same along y.
        turn: Angle from the mounting that these three describe, rad about the plate's normal.
        skew: By how much the screen's axes differ from a right angle, rad.
        centre: Where on the plate the middle of the screen is, m.
    """

    size: tuple[float, float]
    swapped: bool
    mirrored_x: bool
    mirrored_y: bool
    turn: float
    skew: float
    centre: tuple[float, float]

    @classmethod
    def of(cls, calibration: Calibration) -> Self:
        """The mounting that is nearest to square, and the turn from it."""
        (a, b), (c, d) = calibration.matrix
        swapped = abs(c) + abs(b) > abs(a) + abs(d)
        # sides along the plate's x and y, whichever of the screen's axes they are
        x, y = ((b, d), (a, c)) if swapped else ((a, c), (b, d))
        mirrored_x, mirrored_y = x[0] < 0, y[1] < 0
        along_x = _turned(atan2(x[1], x[0]) - (pi if mirrored_x else 0.0))
        along_y = _turned(atan2(y[1], y[0]) - (-pi / 2 if mirrored_y else pi / 2))
        return cls(
            (hypot(*x), hypot(*y)),
            swapped,
            mirrored_x,
            mirrored_y,
            (along_x + along_y) / 2,
            along_y - along_x,
            calibration.plate(0.5, 0.5),
        )

    @property
    def lines(self) -> tuple[str, ...]:
        """It in words, a line for each of scale, axes, turn and place."""
        width, height = (1e3 * side for side in self.size)
        first, second = (
            f"the plate's {'-' if mirrored else '+'}{name}"
            for name, mirrored in (("x", self.mirrored_x), ("y", self.mirrored_y))
        )
        if self.swapped:
            first, second = second, first
        return (
            f"scale: sensing area {width:.1f} x {height:.1f} mm along the plate's x and y",
            f"axes: the screen's x runs along {first}, its y along {second}",
            f"turn: {degrees(self.turn):+.2f} deg, skew {degrees(self.skew):+.2f} deg",
            f"offset: its middle is at x {1e3 * self.centre[0]:+.2f}, "
            f"y {1e3 * self.centre[1]:+.2f} mm",
        )

    def as_dict(self) -> dict[str, Any]:
        """It for files and ``--json``."""
        return {
            "size_m": [round(side, 6) for side in self.size],
            "swapped": self.swapped,
            "mirrored_x": self.mirrored_x,
            "mirrored_y": self.mirrored_y,
            "turn_deg": round(degrees(self.turn), 5) + 0.0,
            "skew_deg": round(degrees(self.skew), 5) + 0.0,
            "centre_m": [round(each, 6) for each in self.centre],
        }


def _turned(angle: float) -> float:
    """An angle in -pi..pi."""
    return (angle + pi) % (2 * pi) - pi
