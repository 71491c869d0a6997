"""Fits commands from their middle on where they are far from zero, as pulses of 1500 us are.

Gain and level are nearly one parameter there: a change of one is made up for by the other, and a
fit ends where it began. About the middle m of the commands, u = m + w,

    gain u + level = gain w + (level + gain m),

and the fitted level at the middle is converted to the level at a command of zero afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.base.page import digits
from twin.identify.axis_logs import AnyLog
from twin.identify.verdicts import IDENTIFIED_VERDICT, NOT_IDENTIFIABLE, ParameterVerdict


@dataclass(frozen=True, kw_only=True)
class OffsetTest:
    """Constants.

    Attributes:
        min_ratio: Smallest distance of the middle from zero, in standard deviations, that counts.
        outer_share: Share of the commands at either side that is not regarded.
    """

    min_ratio: float = 4.0
    outer_share: float = 0.01


OFFSET_TEST = OffsetTest()


def find_offsets(logs: Sequence[AnyLog], how: OffsetTest = OFFSET_TEST) -> dict[str, float]:
    """Axis to the middle of its tilts in their unit, of those that stay far from zero.

    Args:
        logs: Of one rig.
        how: Constants.
    """
    found = {}
    for axis in logs[0].axes:
        tilt = np.concatenate([log.axes[axis].tilt for log in logs if axis in log.axes])
        low, middle, high = np.quantile(tilt, (how.outer_share, 0.5, 1 - how.outer_share))
        if (low > 0 or high < 0) and 0 < how.min_ratio * np.std(tilt) < abs(middle):
            found[axis] = float(middle)
    return found


def take_out_offsets(
    logs: Sequence[AnyLog], held: Sequence[AnyLog] | float
) -> tuple[list[AnyLog], list[AnyLog] | float, dict[str, float]]:
    """Logs with tilts from their middle on, those held out too, and axis to the middle.

    Args:
        logs: Of one rig.
        held: Other logs of it, or the share of each log that is held out.
    """
    offsets = find_offsets(logs)

    def shift(log: AnyLog) -> AnyLog:
        axes = {k: replace(v, tilt=v.tilt - offsets.get(k, 0.0)) for k, v in log.axes.items()}
        return replace(log, axes=axes)

    others = held if isinstance(held, float) else [shift(log) for log in held]
    return [shift(log) for log in logs], others, offsets


def tell_level_at_zero(
    verdicts: Sequence[ParameterVerdict], offsets: Mapping[str, float], units: Mapping[str, str]
) -> tuple[list[ParameterVerdict], list[str]]:
    """Verdicts with the level at a tilt of zero instead of the middle, and notes on the middle.

    Gain and level at the middle are as good as uncorrelated, so their intervals add up as
    independent ones.

    Args:
        verdicts: With the level at the middle.
        offsets: Axis to the middle.
        units: Units of the tilts.
    """
    known = {each.name: each for each in verdicts}
    found, notes = list(verdicts), list[str]()
    for k, each in enumerate(verdicts):
        name, _, axis = each.name.rpartition("_")
        if name != "level" or axis not in offsets:
            continue
        notes.append(_describe(axis, offsets[axis], units[axis], each))
        found[k] = _shift(each, known[f"gain_{axis}"], offsets[axis])
    return found, notes


def _shift(level: ParameterVerdict, gain: ParameterVerdict, offset: float) -> ParameterVerdict:
    """A level at a tilt of zero, by its value at an offset and the gain.

    It is known only as far as both have a value and an interval.
    """
    ends = level.value, level.low, level.high, gain.value, gain.low, gain.high
    known = [each for each in ends if each is not None]
    if len(known) < len(ends):
        unknown = "gain" if None in ends[3:] else "level at their middle"
        why = f"commands are far from zero, and the {unknown} is not known with an interval"
        why = "; ".join(filter(None, (level.why, why)))
        return replace(level, value=None, low=None, high=None, word=NOT_IDENTIFIABLE, why=why)
    middle, lowest, highest, slope, *slopes = known
    value = middle - slope * offset
    rises = sorted(offset * (end - slope) for end in slopes)
    low = value - math.hypot(middle - lowest, rises[1])
    high = value + math.hypot(highest - middle, rises[0])
    narrow = (high - low) / 2 <= level.about.allowed_half_width(value)
    word = NOT_IDENTIFIABLE if level.word == IDENTIFIED_VERDICT and not narrow else level.word
    why = "; ".join(filter(None, (level.why, "at a command of zero, far from those of the log")))
    return replace(level, value=value, low=low, high=high, word=word, why=why)


def _describe(axis: str, offset: float, unit: str, level: ParameterVerdict) -> str:
    """A note on commands that are far from zero, with the level at their middle."""
    known = "" if level.value is None else f", where the level is {digits(level.value)} m/s^2"
    return (
        f"{axis}: commands lie about {digits(offset)} {unit}{known}: the fit counts them from "
        "there on; the level of the table is that at a command of zero"
    )
