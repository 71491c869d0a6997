"""The parameters that can be identified: their names and bounds, and what shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from controllers.arrays import Array
from twin.identify.columns import LogError
from twin.sim.plant.friction import Friction


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of the twin that a log may show.

    Attributes:
        key: The scenario key that takes it.
        unit: Unit of the key; empty for dimensionless.
        factor: From the SI number to that of the key.
        start: Where a fit that knows nothing begins, SI.
        least: Smallest value, SI.
        most: Largest value, SI.
        nudge: Step of finite differences, SI; 0 where the derivative is exact.
        wanted: Half-width of the interval up to which it counts as identified, SI.
        share: The same as a share of the value; the larger of the two holds.
        floor: Smallest half-width ever claimed, SI: what the twin's own time step changes.
        experiment: What would show it.
    """

    key: str
    unit: str
    factor: float = 1.0
    start: float = 0.0
    least: float = 0.0
    most: float = math.inf
    nudge: float = 0.0
    wanted: float = 0.0
    share: float = 0.0
    floor: float = 0.0
    experiment: str = ""

    @property
    def name(self) -> str:
        """Short words for tables: the key without its first tables."""
        return self.key.removeprefix("plant.").removeprefix("sensors.")


_START = "let the ball come to rest and start again by itself at least ten times (scenario excite)"
_ROLL = (
    "let the ball roll for half a minute at up to 0.1 m/s and change direction (scenario excite)"
)
_LEVEL = "let the ball roll both ways along x and y (scenario excite)"

BALL: dict[str, Parameter] = {
    "rolling": Parameter(
        key="plant.friction.rolling_mm",
        unit="mm",
        factor=1e3,
        start=2e-4,
        most=3e-3,
        nudge=3e-6,
        wanted=1e-5,
        share=0.1,
        floor=5e-7,
        experiment=_ROLL,
    ),
    "breakaway": Parameter(
        key="plant.friction.breakaway_ratio",
        unit="",
        start=1.2,
        least=1.0,
        most=6.0,
        nudge=0.02,
        share=0.1,
        floor=0.005,
        experiment=_START,
    ),
    "delay": Parameter(
        key="sensors.touch.dead_time",
        unit="s",
        start=0.042,
        most=0.14,
        wanted=0.004,
        share=0.1,
        floor=2e-4,
        experiment="move the plate faster while the ball rolls (scenario excite)",
    ),
    "level_phi": Parameter(
        key="plant.level_deg",
        unit="deg",
        factor=math.degrees(1),
        least=-0.05,
        most=0.05,
        nudge=2e-4,
        wanted=5e-4,
        floor=1e-5,
        experiment=_LEVEL,
    ),
    "level_theta": Parameter(
        key="plant.level_deg",
        unit="deg",
        factor=math.degrees(1),
        least=-0.05,
        most=0.05,
        nudge=2e-4,
        wanted=5e-4,
        floor=1e-5,
        experiment=_LEVEL,
    ),
    "viscous": Parameter(
        key="plant.friction.viscous_mm",
        unit="mm",
        factor=1e3,
        most=0.01,
        nudge=2e-5,
        wanted=1e-4,
        share=0.2,
        floor=5e-6,
        experiment="let the ball roll at up to 0.3 m/s as well as slowly",
    ),
    "stribeck": Parameter(
        key="plant.friction.stribeck_speed",
        unit="m/s",
        start=0.005,
        least=5e-4,
        most=0.05,
        nudge=2e-4,
        wanted=0.001,
        share=0.2,
        floor=1e-4,
        experiment=_START,
    ),
    "dwell": Parameter(
        key="plant.friction.dwell_time",
        unit="s",
        most=10.0,
        nudge=0.02,
        wanted=0.1,
        share=0.2,
        floor=0.01,
        experiment="let the ball rest for times between 0.1 and 10 s before it starts",
    ),
}
"""What shows in the ball's motion, by the name the command line uses (level: both)."""

SERVO = Parameter(
    key="plant.servo.bandwidth_hz",
    unit="Hz",
    most=0.15,
    wanted=0.0005,
    share=0.1,
    floor=5e-5,
    experiment="move the plate faster, and record the commanded plate acceleration",
)
"""The drives' time constant in s; the scenario wants the corner frequency it gives."""

HIDDEN = {
    "spring": Parameter(
        key="plant.spring.preload",
        unit="N",
        experiment="measure motor torque while the plate is tilted slowly over its whole range",
    ),
    "wheels": Parameter(
        key="plant.wheels.stiffness",
        unit="N/m",
        experiment="tap the plate and record its encoders at 500 Hz or faster (see ballplate "
        "calibrate cams, which does this on the twin)",
    ),
    "plate_centre": Parameter(
        key="plant.plate.offset_mm",
        unit="mm",
        experiment="measure motor torque at rest in many poses, spring taken off",
    ),
    "ball_centre": Parameter(
        key="plant.ball.offset_mm",
        unit="mm",
        experiment="roll the ball from rest on a level plate and see where it settles",
    ),
}
"""What neither ball nor plate positions of a closed-loop run show."""

CHOICES = (
    "rolling",
    "breakaway",
    "delay",
    "servo",
    "level",
    "viscous",
    "stribeck",
    "dwell",
    *HIDDEN,
)
DEFAULT = ("rolling", "breakaway", "delay", "servo", "level")
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
    return Friction(
        rolling=values["rolling"],
        breakaway_ratio=values["breakaway"],
        stribeck_speed=values["stribeck"],
        dwell_time=values["dwell"],
        viscous=values["viscous"],
    )
