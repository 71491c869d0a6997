"""Where a log has nothing, or nothing in time: shown, and evidence of nothing."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from controllers.arrays import Array, Mask
from twin.identify.log import Log
from twin.shadow.evidence import Evidence

MISSED = 1.5
"""Periods from one row to the next from which on there is a gap."""
LATE = 0.5
"""Share of a period from which on a row was taken too late: what it holds is of another time."""


def gaps(log: Log, period: float) -> Array:
    """Begin and end in s of what is missing or late, shape (G, 2).

    Args:
        log: What was recorded.
        period: Seconds between rows.
    """
    known = np.isfinite(log.time)
    time = log.time[known]
    missing = np.flatnonzero(np.diff(time) > MISSED * period)
    found = np.stack((time[missing], time[missing + 1]), axis=-1)
    if log.late is not None:
        late = np.nan_to_num(log.late[known])
        behind = late > LATE * period
        found = np.concatenate((found, np.stack((time, time + late), axis=-1)[behind]))
    return found[np.argsort(found[:, 0], kind="stable")]


def clear(begin: Array, end: Array, gaps: Array, after: float = 0.0) -> Mask:
    """Which spans of time hold no part of a gap, shape (W,).

    Args:
        begin: Seconds, shape (W,).
        end: Seconds, shape (W,).
        gaps: Begin and end of each in s, shape (G, 2).
        after: Seconds for which a gap is still felt.
    """
    touched = (gaps[:, 0] < end[:, None]) & (gaps[:, 1] + after > begin[:, None])
    return np.asarray(~touched.any(axis=1))


def undisturbed(
    parts: Iterable[Evidence | None], gaps: Array, after: float = 0.0
) -> Evidence | None:
    """What windows without a gap say; None if there is no window at all.

    Args:
        parts: Of the segments of a log; None where one is too short.
        gaps: Begin and end of each in s, shape (G, 2).
        after: Seconds for which a gap is still felt.
    """
    found = [part for part in parts if part is not None]
    if not found:
        return None
    every = Evidence.join(found)
    return every.take(clear(every.begin, every.end, gaps, after))
