"""What a problem did to the motion: how far an axis moved on, and when it stood."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from itertools import pairwise

from twin.devices.akd.decoding import Conversation
from twin.devices.akd.object_names import PLACE, key_of_axis

MAX_COAST_S = 5.0
"""Time in s after a problem within which the motion belongs to it."""
MAX_SAMPLE_AGE_S = 0.1
"""Age in s of a position that an axis still has when a problem begins."""
AT_ONCE_S = 0.005
"""Time in s within which an axis stands at once."""
HALF_RANGE = 1 << 31
"""Half of the counts after which an encoder of 32 bits wraps."""
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
    plate = trace.objects.plate_object(node) if axis == 1 else None
    for name, key in (("plate", plate), ("axis", key_of_axis(PLACE, axis))):
        series = trace.series.get((node, key)) if key else None
        if series is None or key is None:
            continue
        time = series.time
        first = max(bisect_left(time, begin) - 1, bisect_left(time, begin - MAX_SAMPLE_AGE_S), 0)
        last = bisect_right(time, min(begin + MAX_COAST_S, end))
        if last - first < 2:  # nothing is sent after it
            continue
        moved = _since_first(series.counts[first:last])
        farthest = max(moved, key=abs)
        if abs(farthest) <= STILL_COUNTS:
            return f"the {name} did not move"
        factor, unit = trace.objects.scale(node, key)
        way = f"{abs(farthest):.0f} counts"
        if unit == "rad":
            way = f"{math.degrees(abs(farthest * factor)):.3g} deg"
        tolerance = max(STILL_COUNTS, STILL_SHARE * abs(farthest))
        moving = [k for k, each in enumerate(moved) if abs(each - moved[-1]) > tolerance]
        rest = moving[-1] + 1 if moving else 0
        if rest >= len(moved) - 2:
            still = trace.span(time[last - 1] - begin)
            return f"the {name} moved on by {way}, and still moved {still} later"
        stood = time[first + rest] - begin
        when = "at once" if stood < AT_ONCE_S else f"after {trace.span(stood)}"
        return f"the {name} coasted {way}, and stood {when}"
    return ""


def _since_first(counts: Sequence[float]) -> list[float]:
    """Counts of an encoder of 32 bits since the first of them; it may wrap in between."""
    moved = [0.0]
    for before, now in pairwise(counts):
        moved.append(moved[-1] + (now - before + HALF_RANGE) % (2 * HALF_RANGE) - HALF_RANGE)
    return moved
