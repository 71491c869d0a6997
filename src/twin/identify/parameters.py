"""The parameters that can be identified: their names and bounds, and what shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from twin.errors import LogError

if TYPE_CHECKING:
    from controllers.arrays import Array
    from twin.sim.plant.friction import Friction

_FACTORS = {"mm": 1e3, "deg": math.degrees(1)}


@dataclass(frozen=True)
class IdentifiedParameter:
    """One number of the twin that a log may show. All values but that of the key are in SI units.

    Attributes:
        key: The scenario key that takes it.
        unit: Unit of the key; empty for dimensionless.
        experiment: What would show it.
        start: Where a fit without a first guess begins.
        least: Smallest value.
        most: Largest value.
        difference: Step of finite differences; 0 where the derivative is exact.
        tolerance: Half-width of the interval up to which it counts as identified.
        relative: The same as a share of the value; the larger of the two holds.
        floor: Smallest half-width ever claimed: what the twin's own time step changes.
    """

    key: str
    unit: str
    experiment: str
    start: float = 0.0
    least: float = 0.0
    most: float = math.inf
    difference: float = 0.0
    tolerance: float = 0.0
    relative: float = 0.0
    floor: float = 0.0

    @property
    def factor(self) -> float:
        """From the SI number to that of the key."""
        return _FACTORS.get(self.unit, 1.0)

    @property
    def name(self) -> str:
        """Short words for tables: the key without its first tables."""
        return self.key.removeprefix("plant.").removeprefix("sensors.")


_START = "let the ball come to rest and start again by itself at least ten times (scenario excite)"
_ROLL = (
    "let the ball roll for half a minute at up to 0.1 m/s and change direction (scenario excite)"
)
_LEVEL = IdentifiedParameter(
    "plant.level_deg", "deg", "let the ball roll both ways along x and y (scenario excite)",
    least=-0.05, most=0.05, difference=2e-4, tolerance=5e-4, floor=1e-5,
)  # fmt: skip

BALL = {
    "rolling": IdentifiedParameter(
        "plant.friction.rolling_mm", "mm", _ROLL,
        start=2e-4, most=3e-3, difference=3e-6, tolerance=1e-5, relative=0.1, floor=5e-7,
    ),
    "breakaway": IdentifiedParameter(
        "plant.friction.breakaway_ratio", "", _START,
        start=1.2, least=1.0, most=6.0, difference=0.02, relative=0.1, floor=0.005,
    ),
    "delay": IdentifiedParameter(
        "sensors.touch.dead_time", "s",
        "move the plate faster while the ball rolls (scenario excite)",
        start=0.042, most=0.14, tolerance=0.004, relative=0.1, floor=2e-4,
    ),
    "level_phi": _LEVEL,
    "level_theta": _LEVEL,
    "viscous": IdentifiedParameter(
        "plant.friction.viscous_mm", "mm",
        "let the ball roll at up to 0.3 m/s as well as slowly",
        most=0.01, difference=2e-5, tolerance=1e-4, relative=0.2, floor=5e-6,
    ),
    "stribeck": IdentifiedParameter(
        "plant.friction.stribeck_speed", "m/s", _START,
        start=0.005, least=5e-4, most=0.05, difference=2e-4,
        tolerance=0.001, relative=0.2, floor=1e-4,
    ),
    "dwell": IdentifiedParameter(
        "plant.friction.dwell_time", "s",
        "let the ball rest for times between 0.1 and 10 s before it starts",
        most=10.0, difference=0.02, tolerance=0.1, relative=0.2, floor=0.01,
    ),
    "gain": IdentifiedParameter(
        "plant.ball.inertia", "", _ROLL, start=1.0, least=0.5, most=1.5, difference=0.005,
    ),
}  # fmt: skip
"""What shows in the ball's motion, by the name the command line uses (level: both)."""

SERVO = IdentifiedParameter(
    "plant.servo.bandwidth_hz", "Hz",
    "move the plate faster, and record the commanded plate acceleration",
    most=0.15, tolerance=0.0005, relative=0.1, floor=2e-4,
)  # fmt: skip
"""The drives' time constant in s; the scenario takes the corner frequency it gives. The floor is
what differs from law to law where servos of the rig's own are taken as a mere delay."""

HIDDEN = {
    "spring": IdentifiedParameter(
        "plant.spring.preload", "N",
        "measure motor torque while the plate is tilted slowly over its whole range",
    ),
    "wheels": IdentifiedParameter(
        "plant.wheels.stiffness", "N/m",
        "tap the plate and record its encoders at 500 Hz or faster (see ballplate calibrate cams, "
        "which does this on the twin)",
    ),
    "plate_centre": IdentifiedParameter(
        "plant.plate.offset_mm", "mm",
        "measure motor torque at rest in many poses, spring taken off",
    ),
    "lost_motion": IdentifiedParameter(
        "plant.servo.backlash_deg", "deg",
        "turn the plate by a slow triangle without the ball, motors against plate encoders "
        "(ballplate calibrate lost-motion): width and corners of the loop",
    ),
    "start": IdentifiedParameter(
        "reference.start", "s",
        "record the reference beside the ball: a fit sees the plate's motion, not what asked for "
        "it, and the largest angles and efforts of a run may be those of its start",
    ),
    "ball_centre": IdentifiedParameter(
        "plant.ball.offset_mm", "mm",
        "roll the ball from rest on a level plate and see where it settles",
    ),
}  # fmt: skip
"""What neither ball nor plate positions of a closed-loop run show."""

DEFAULT = ("rolling", "breakaway", "delay", "servo", "level")
SHARE = 2 / 3
"""Share of the usable time that is fitted; the rest is held out."""
CHOICES = (*DEFAULT, "viscous", "stribeck", "dwell", *HIDDEN)
ALWAYS = ("rolling", "breakaway", "delay", "level_phi", "level_theta")
"""Fitted whether asked for or not: to hold one at a guess would spoil the others."""


def chosen(text: str | None) -> tuple[str, ...]:
    """The parameters of a list with commas; None for the usual ones.

    Raises:
        LogError: If one is unknown.
    """
    if text is None:
        return DEFAULT
    names = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    unknown = [name for name in names if name not in CHOICES]
    if unknown or not names:
        raise LogError(
            f"--parameters: no '{', '.join(unknown) or text}' (known: {', '.join(CHOICES)})"
        )
    return names


def fitted(names: tuple[str, ...]) -> tuple[str, ...]:
    """The ball parameters that a fit for these has to find."""
    return (*ALWAYS, *(name for name in BALL if name in names and name not in ALWAYS))


def friction(values: Mapping[str, Array]) -> Friction:
    """The friction object of parameter values; the one place that builds it."""
    from twin.sim.plant.friction import Friction  # noqa: PLC0415  heavy: a help needs the names

    return Friction(
        rolling=values["rolling"],
        breakaway_ratio=values["breakaway"],
        stribeck_speed=values["stribeck"],
        dwell_time=values["dwell"],
        viscous=values["viscous"],
    )
