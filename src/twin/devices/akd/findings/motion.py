"""What a problem did to the motion: how far an axis moved on, and when it stood."""

from __future__ import annotations

import math

import numpy as np

from twin.devices.akd.decoding import AXIS_OFFSET, PLACE, Conversation

MAX_COAST_S = 5.0
"""Time in s after a problem within which the motion belongs to it."""
MAX_SAMPLE_AGE_S = 0.1
"""Age in s of a position that an axis still has when a problem begins."""
AT_ONCE_S = 0.005
"""Time in s within which an axis stands at once."""
STILL_COUNTS = 2
"""Counts of an encoder that are no motion."""
STILL_SHARE = 0.02
"""Share of the way on which an axis counts as standing."""


def coasting(trace: Conversation, node: int, axis: int, begin: float, end: float) -> str:
    """How an axis moved on after a problem, in words; empty where no PDO shows its position.

    The plate's encoder is taken where a rig file names it, else the position of the axis.

    Args:
        trace: The trace.
        node: The drive.
        axis: Its axis, 1 for the first.
        begin: When the problem began, s.
        end: When it was over, s.
    """
    plate = trace.plate_object(node) if axis == 1 else None
    own = (PLACE + (axis - 1) * AXIS_OFFSET, 0)
    for name, key in (("plate", plate), ("axis", own)):
        series = trace.series.get((node, key)) if key else None
        if series is None or key is None:
            continue
        time = np.asarray(series.time)
        first = max(int(np.searchsorted(time, begin - MAX_SAMPLE_AGE_S)), 0)
        first = max(int(np.searchsorted(time, begin)) - 1, first)
        last = int(np.searchsorted(time, min(begin + MAX_COAST_S, end), side="right"))
        if last - first < 2:  # nothing is sent after it
            continue
        place = np.unwrap(np.asarray(series.counts[first:last], float), period=2.0**32)
        moved, passed = place - place[0], time[first:last] - begin
        farthest = float(moved[np.abs(moved).argmax()])
        if abs(farthest) <= STILL_COUNTS:
            return f"the {name} did not move"
        factor, unit = trace.scale(node, key)
        way = f"{abs(farthest):.0f} counts"
        if unit == "rad":
            way = f"{math.degrees(abs(farthest * factor)):.3g} deg"
        moving = np.abs(moved - moved[-1]) > max(STILL_COUNTS, STILL_SHARE * abs(farthest))
        rest = int(np.flatnonzero(moving)[-1]) + 1 if moving.any() else 0
        if rest >= len(moved) - 2:
            still = trace.span(float(passed[-1]))
            return f"the {name} moved on by {way}, and still moved {still} later"
        stood = float(passed[rest])
        when = "at once" if stood < AT_ONCE_S else f"after {trace.span(stood)}"
        return f"the {name} coasted {way}, and stood {when}"
    return ""
