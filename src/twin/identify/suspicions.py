"""Names what is suspicious about a log by first looks: signs, axes, units, the ball, the clock."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from controllers.ballplate import BallPlate
from twin.base.page import digits
from twin.identify.axis_logs import AxisLog
from twin.identify.balls import GRAVITY_SHARES
from twin.identify.first_look import FirstLook, look_plainly
from twin.identify.log_columns import AXIS_COLUMNS
from twin.identify.weak_form import WEAK_FORM

AXIS_SIGNS = {"x": 1.0, "y": -1.0}
"""The axes, and the sign of the acceleration along them by a positive tilt of the plate."""


@dataclass(frozen=True, kw_only=True)
class Suspicion:
    """Constants of what is suspicious.

    Attributes:
        unit_ratio: Largest ratio of a gain to the gain of a ball by which a unit is recognised.
        max_gain_half_width: Largest half-width of the interval of a gain by which a ball is named,
            as a share of the gain.
        gain_tolerance: Share of a gain by which it may differ from the gain of a ball at least.
        exchanged_share: Share of the variance by which the other axis's command has to explain more
            than the axis's own.
    """

    unit_ratio: float = 1.6
    max_gain_half_width: float = 0.1
    gain_tolerance: float = 0.02
    exchanged_share: float = 0.3


SUSPICION_LIMITS = Suspicion()


def describe_suspicions(
    logs: Mapping[str, AxisLog],
    units: Mapping[str, str],
    looks: Mapping[str, FirstLook | None],
    factor: float,
    how: Suspicion = SUSPICION_LIMITS,
) -> Iterator[str]:
    """What is suspicious about a log, in sentences.

    Args:
        logs: The log of each axis.
        units: Units of their tilt.
        looks: First looks at them.
        factor: Share of gravity that accelerates the ball, as assumed.
        how: Constants.
    """
    exchanged = are_axes_exchanged(logs, how)
    if exchanged:
        yield (
            "the axes look exchanged: each position follows the command of the other axis; give "
            "command_phi the column that moves the ball along x, command_theta that along y"
        )
    for axis, look in looks.items():
        if look is None or exchanged:
            continue
        if units[axis] == "rad":
            yield from _describe_gain(axis, look, factor, how, held=logs[axis].held)
        if look.drifts():
            yield (
                f"{axis}: the clock of the positions looks {1e6 * look.drift:+.0f} +- "
                f"{2e6 * look.drift_std:.0f} ppm off the clock of the commands"
            )


def are_axes_exchanged(logs: Mapping[str, AxisLog], how: Suspicion = SUSPICION_LIMITS) -> bool:
    """Whether the ball follows along each axis the command of the other one, and not its own."""
    if set(logs) != set(AXIS_COLUMNS):
        return False
    for axis, other in (("x", "y"), ("y", "x")):
        theirs = logs[other]
        swapped = replace(logs[axis], time=theirs.time, tilt=theirs.tilt, held=theirs.held)
        every = (
            look_plainly(each, WEAK_FORM.plain_windows_s[-1]) for each in (logs[axis], swapped)
        )
        own, crossed = (look.explained if look else 0.0 for look in every)
        if crossed < own + how.exchanged_share:
            return False
    return True


def _describe_gain(
    axis: str, look: FirstLook, factor: float, how: Suspicion, *, held: bool
) -> Iterator[str]:
    """A sign, unit or ball by which the gain of an axis would be as it looks.

    Args:
        axis: x or y.
        look: The look at it.
        factor: Share of gravity that accelerates the ball, as assumed.
        how: Constants.
        held: Whether the tilt is a command.
    """
    push = AXIS_SIGNS[axis] * factor * BallPlate().gravity
    role = f"{'command' if held else 'measured'}_{AXIS_COLUMNS[axis][1]}"
    if look.gain * push < 0:
        yield (
            f"{axis}: wrong sign of {role}: a positive one moves the ball towards "
            f"{'-' if push > 0 else '+'}{axis}; give {role}=-NAME, or without - a name that has it"
        )
    size = abs(look.gain / push)
    for ratio, advice in (
        (math.radians(1), f"degrees taken for radians? give {role}=NAME:deg"),
        (math.degrees(1), f"radians taken for degrees? give {role}=NAME:rad"),
    ):
        if 1 / how.unit_ratio < size / ratio < how.unit_ratio:
            yield f"{axis}: the gain is {digits(size)} times that of the ball: {advice}"
    low, high = look.interval("gain")
    if high - low > 2 * how.max_gain_half_width * abs(look.gain):
        return
    if name := find_other_ball(look.gain, low, high, factor, how):
        yield (
            f"{axis}: the gain is that of a {name} ball, {GRAVITY_SHARES[name]:.2g} of gravity, "
            f"not the assumed {factor:.2g}: --ball {name}, or the plate tilts {digits(size)} times "
            "as far as commanded"
        )


def find_other_ball(
    gain: float, low: float, high: float, factor: float, how: Suspicion = SUSPICION_LIMITS
) -> str:
    """The ball that a gain suggests in place of the assumed one; empty if none.

    Args:
        gain: Acceleration by tilt, m/s^2 per rad; its sign does not matter.
        low: Lower end of its interval.
        high: Upper end.
        factor: Share of gravity that accelerates the ball, as assumed.
        how: Constants.
    """
    low, high = sorted(math.copysign(1.0, gain) * end for end in (low, high))
    low = min(low, (1 - how.gain_tolerance) * abs(gain))
    high = max(high, (1 + how.gain_tolerance) * abs(gain))
    gravity = BallPlate().gravity
    if low <= factor * gravity <= high:
        return ""
    fitting = (name for name, share in GRAVITY_SHARES.items() if low <= share * gravity <= high)
    return next(fitting, "")
