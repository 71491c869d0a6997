"""The parameters that can be identified: their names and bounds, and what shows them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

from twin.base.data_file import read_toml
from twin.base.errors import LogError

_UNIT_FACTORS = {"mm": 1e3, "deg": math.degrees(1)}


@dataclass(frozen=True)
class IdentifiedParameter:
    """One parameter that a log may show. All values are in SI units, only ``key`` has its own unit.

    Attributes:
        key: The scenario key that takes it.
        unit: Unit of the key; empty for dimensionless.
        experiment: The experiment that shows it.
        start: Where a fit without a first guess begins.
        least: Smallest value.
        most: Largest value.
        difference: Step of finite differences; 0 where the derivative is exact.
        tolerance: Half-width of the interval up to which it counts as identified.
        relative: The same as a share of the value; the larger of the two holds.
        floor: Smallest half-width ever claimed: what the twin's own time step changes.
        tried: Rising values, from zero, of a parameter in which the cost has no slope.
        spread: Prior standard deviation about ``start``.
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
    tried: tuple[float, ...] = ()
    spread: float = math.inf

    @property
    def factor(self) -> float:
        """Factor from the SI value to the unit of the key."""
        return _UNIT_FACTORS.get(self.unit, 1.0)

    def allowed_half_width(self, value: float) -> float:
        """Half-width of the interval of a value up to which it counts as identified."""
        return max(self.tolerance, self.relative * abs(value))


_PARAMETER_TABLES = read_toml(Path(__file__).with_suffix(".toml"))
BALL_PARAMETERS = {
    name: IdentifiedParameter(**about) for name, about in _PARAMETER_TABLES["ball"].items()
}
"""Parameters that the ball's motion shows, by their names on the command line (level: both)."""
SERVO_PARAMETER = IdentifiedParameter(**_PARAMETER_TABLES["servo"])
"""The drives' time constant in s; the scenario takes the corner frequency it gives."""
DRIVE_PARAMETERS = {
    name: IdentifiedParameter(**about) for name, about in _PARAMETER_TABLES["drives"].items()
}
"""Parameters that the plate's encoders show: lag, elasticity of both axes, play."""
PLAIN_PARAMETERS = {
    name: IdentifiedParameter(**about) for name, about in _PARAMETER_TABLES["plain"].items()
}
"""The plain model of any rig, of each axis; gain, friction and level are accelerations."""
DELAY_FLOOR_S = 0.002
"""Smallest half-width claimed for dead time and lag together, s: a second lag behind the first, as
of a filter of the positions, moves the sum by so much."""


MEASURE_ANGLE_TEXT = "measure the plate's angle, and "
"""Begin of an experiment that is advised for a log of commands alone."""


def plain_parameter(name: str, unit: str, *, held: bool = True) -> IdentifiedParameter:
    """A parameter of the plain model, or the sum of its delays.

    Args:
        name: In ``PLAIN_PARAMETERS``, or ``delay``.
        unit: Unit of the tilt, which stands in the parameter's unit for rad.
        held: Whether the tilt is a command; of a measured angle no experiment asks to measure it.
    """
    if name == "delay":
        return replace(PLAIN_PARAMETERS["dead_time"], key="dead time + lag", floor=DELAY_FLOOR_S)
    about = PLAIN_PARAMETERS[name]
    if not held:
        about = replace(about, experiment=about.experiment.removeprefix(MEASURE_ANGLE_TEXT))
    return replace(about, unit=re.sub(r"\brad\b", unit, about.unit))


HIDDEN_PARAMETERS = {
    name: IdentifiedParameter(**about) for name, about in _PARAMETER_TABLES["hidden"].items()
}
"""Not identifiable from closed-loop positions of ball and plate."""

DEFAULT_PARAMETERS = ("rolling", "breakaway", "delay", "servo", "level")
FITTED_SHARE = 0.67
"""Share of the usable time that is fitted; the rest is held out."""
PARAMETER_CHOICES = (*DEFAULT_PARAMETERS, "viscous", "stribeck", "dwell", *HIDDEN_PARAMETERS)
ALWAYS_FITTED = ("rolling", "breakaway", "delay", "level_phi", "level_theta")
"""Fitted whether requested or not: a guess of one would bias the others."""
LEVEL_PARAMETERS = ALWAYS_FITTED[-2:]
"""The level of each axis."""
AT_REST = ("stribeck", "dwell")
"""Ageing of friction at rest: fitted as well if a log is not explained without."""


def choose_parameters(
    text: str | None,
    known: tuple[str, ...] = PARAMETER_CHOICES,
    usual: tuple[str, ...] = DEFAULT_PARAMETERS,
) -> tuple[str, ...]:
    """The parameters of a comma-separated list, of those known; None for the usual ones.

    Raises:
        LogError: If one is unknown.
    """
    if text is None:
        return usual
    names = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        raise LogError(
            f"--parameters: no '{', '.join(unknown) or text}' (known: {', '.join(known)})"
        )
    return names


def fitted_parameters(names: tuple[str, ...], axes: int = 2) -> tuple[str, ...]:
    """The ball parameters that a fit for these has to find on a rig of so many axes."""
    return (
        *(name for name in ALWAYS_FITTED if name not in LEVEL_PARAMETERS[axes:]),
        *(name for name in BALL_PARAMETERS if name in names and name not in ALWAYS_FITTED),
    )
