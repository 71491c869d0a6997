"""Rhythms of a trace: the usual pause of what comes regularly, and the gaps in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING

from twin.devices.akd import protocol
from twin.devices.akd.observed import BUS, Gap, Rhythm, Stream, StreamKey

if TYPE_CHECKING:
    from twin.devices.akd.trace_files.frames import BusFrame

LONG_PAUSE = 1.6
"""Multiple of the usual pause above which a pause is a gap."""
_IRREGULAR_SHARE = 0.05
"""Share of long pauses above which a sequence of frames is not regular."""
_MIN_FRAMES = 10
"""Fewest frames in which a rhythm is seen."""
_END_PAUSES, _MIN_END_S = 3, 0.05
"""Times the usual pause, and time in s, from which a stream has ended before the trace does."""


def sync_period(frames: Sequence[BusFrame]) -> float:
    """The period in s, in whole ms, of the SYNCs of a trace; the nominal one if there are few."""
    times = [each.timestamp for each in frames if each.arbitration_id == protocol.SYNC]
    if len(times) <= _MIN_FRAMES:
        from twin.hal.interface import NOMINAL_PERIOD  # noqa: PLC0415  loads numpy

        return NOMINAL_PERIOD
    return max(1, round(1e3 * median(after - before for before, after in pairwise(times)))) / 1e3


def find_rhythms(
    streams: Mapping[StreamKey, Stream], duration: float
) -> Iterator[tuple[StreamKey, Rhythm]]:
    """The rhythm of each stream that comes regularly; SYNC first.

    Args:
        streams: When SYNC, heartbeats and PDOs came.
        duration: Of the trace, s.
    """
    for key in sorted(streams, key=lambda each: each.node != BUS):
        times, frames = streams[key]
        if len(times) < _MIN_FRAMES:
            continue
        pauses = [after - before for before, after in pairwise(times)]
        usual, last = median(pauses), times[-1]
        long = [k for k, pause in enumerate(pauses) if pause > LONG_PAUSE * usual]
        if len(long) > _IRREGULAR_SHARE * len(pauses):
            continue
        gaps = [Gap(times[k], times[k + 1], frames[k]) for k in long]
        if duration - last > max(_END_PAUSES * usual, _MIN_END_S):
            gaps.append(Gap(last, None, frames[-1]))
        yield key, Rhythm(usual, max(pauses), gaps)


def without_missing_sync(
    key: StreamKey, gaps: Sequence[Gap], missing_sync: Sequence[Gap]
) -> list[Gap]:
    """The gaps of a stream that a missing SYNC does not explain: of PDOs those at other times.

    Args:
        key: The stream.
        gaps: Its gaps.
        missing_sync: The gaps of SYNC.
    """
    if key.node == BUS or key.name == "heartbeat":
        return list(gaps)
    return [each for each in gaps if not any(_overlap(each, gap) for gap in missing_sync)]


def _overlap(one: Gap, other: Gap) -> bool:
    """Whether two gaps that are over lie at the same time."""
    if one.end is None or other.end is None:
        return False
    return one.begin < other.end and other.begin < one.end
