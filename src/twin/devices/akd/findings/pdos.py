"""Findings of PDOs: missing, late or twice for their SYNC, or of a wrong length."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from twin.base.errors import plural
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.findings.drives import has_torque
from twin.devices.akd.findings.finding import (
    SILENCES,
    Finding,
    Severity,
    is_explained,
    severity_at_end,
)
from twin.devices.akd.findings.network import (
    ANSWER_S,
    LEAVING_COMMANDS,
    LOST_PAUSES,
    OBEY_S,
    was_commanded,
)
from twin.devices.akd.observed import BUS, StreamKey
from twin.devices.akd.protocol import AT_EVERY_SYNC

MIN_SYNCS = 20
"""SYNCs from which it is seen whether a PDO comes with each."""
EACH_SYNC_SHARES = 0.9, 1.1
"""PDOs for each SYNC, at least and at most, of one that comes with each."""
MISSING_AT_END = 3
"""SYNCs without a PDO, to the end of the trace, after which it has ended."""
MADE_UP_WITHIN = 10
"""SYNCs within which a PDO too many makes up for one that is missing."""
MISSING_IN_A_ROW = 3
"""SYNCs without a PDO in a row that are more than a warning."""
MIN_TWICE = 3
"""How often a PDO comes twice for a SYNC before somebody sends it twice."""
_GAP_CAUSES = (*SILENCES, "nmt-left", "sync-lost")
"""Codes of findings that explain a missing PDO."""


class Cycles(NamedTuple):
    """The PDOs of a stream by the SYNCs that they belong to.

    Attributes:
        sync: Times of the SYNCs from the first PDO's to the last PDO's, s.
        counts: PDOs after each of them.
        last: The time of the last PDO after each of them, s; the SYNC's own without one.
        later: SYNCs after the last PDO's.
    """

    sync: Sequence[float]
    counts: list[int]
    last: list[float]
    later: int


def cycles(trace: Conversation, stream: StreamKey) -> Cycles | None:
    """A stream by SYNCs, in the order of the frames; None if it does not come with each SYNC."""
    syncs, its = trace.observed.streams[StreamKey(BUS, "SYNC")], trace.observed.streams[stream]
    if min(len(syncs.time), len(its.time)) < MIN_SYNCS or not trace.timed:
        return None
    places = [bisect_left(syncs.frame, frame) - 1 for frame in its.frame]
    first, end = max(places[0], 0), places[-1] + 1
    if end <= first:
        return None
    counts, last = [0] * (end - first), list(syncs.time[first:end])
    for place, time in zip(places, its.time, strict=True):
        if place >= 0:
            counts[place - first] += 1
            last[place - first] = time
    index = (0x1800 if stream.name[0] == "T" else 0x1400) + int(stream.name[4:]) - 1
    kind = trace.objects.values[stream.node].get((index, 2))
    share = sum(counts) / len(counts)
    each = (
        EACH_SYNC_SHARES[0] <= share <= EACH_SYNC_SHARES[1]
        if kind is None
        else kind == AT_EVERY_SYNC
    )
    return Cycles(syncs.time[first:end], counts, last, len(syncs.time) - end) if each else None


def find_missing_pdos(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """PDOs that are missing, late or twice for their SYNC, and those that ended.

    What several PDOs of a node have at the same time is one finding.
    """
    joined: dict[tuple[object, ...], Finding] = {}
    for each in _of_streams(trace, known):
        name, _, text = each.text.partition(": ")
        key = each.code, each.node, each.severity, text, round(each.time, 2)
        if key in joined:
            first = joined[key]
            names, _, _ = first.text.partition(": ")
            frames = tuple(sorted((*first.frames, *each.frames)))
            joined[key] = replace(first, text=f"{names}, {name}: {text}", frames=frames)
        else:
            joined[key] = each
    yield from joined.values()


def _of_streams(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """The same, of each PDO."""
    for stream in sorted(trace.observed.streams):
        if stream.name[1:4] != "PDO":
            continue
        found = cycles(trace, stream)
        if found is None:
            yield from _uneven(trace, stream, known)
            continue
        missing, late, twice = _sorted_out(found.counts)
        missing = [
            k for k in missing if not is_explained(known, _GAP_CAUSES, stream.node, found.sync[k])
        ]
        if missing:
            yield _missing(trace, stream, found, missing)
        if late:
            yield _late(trace, stream, found, late)
        if len(twice) > MIN_TWICE:
            yield _twice(trace, stream, found, twice)
        if found.later > MISSING_AT_END:
            yield from _find_ended_streams(trace, stream, known)


def _sorted_out(counts: Sequence[int]) -> tuple[list[int], list[int], list[int]]:
    """The SYNCs without a PDO, those with a PDO after the next SYNC, those with too many.

    Args:
        counts: PDOs after each SYNC. More than one make up for SYNCs without one
            shortly before.
    """
    missing, late, twice, waiting = list[int](), list[int](), list[int](), list[int]()
    for k in [place for place, count in enumerate(counts) if count != 1]:
        missing += [each for each in waiting if k - each > MADE_UP_WITHIN]
        waiting = [each for each in waiting if k - each <= MADE_UP_WITHIN]
        surplus = counts[k] - 1
        if surplus < 0:
            waiting.append(k)
            continue
        if surplus > len(waiting):
            twice.append(k)
        kept = max(len(waiting) - surplus, 0)
        late += waiting[kept:]
        waiting = waiting[:kept]
    return missing + waiting, late, twice


def _frames(trace: Conversation, stream: StreamKey, times: Iterable[float]) -> tuple[int, ...]:
    """Numbers of the last frames of a stream up to some times in s."""
    its = trace.observed.streams[stream]
    places = (max(bisect_right(its.time, time) - 1, 0) for time in times)
    return tuple(dict.fromkeys(its.frame[place] for place in places))


def _missing(trace: Conversation, stream: StreamKey, found: Cycles, missing: list[int]) -> Finding:
    begins = [k for k, each in enumerate(missing) if not k or each > missing[k - 1] + 1]
    ends = [*begins[1:], len(missing)]
    longest = max(end - begin for begin, end in zip(begins, ends, strict=True))
    text = f"{stream.name}: missing for {len(missing)} of {plural(len(found.counts), 'SYNC')}"
    text += f", at worst for {longest} in a row" if longest > 1 else ""
    return Finding(
        code="pdo-missing",
        severity=Severity.RECOVERED if longest >= MISSING_IN_A_ROW else Severity.WARNING,
        time=found.sync[missing[0]],
        until=found.sync[missing[-1] + 1],
        node=stream.node,
        text=text,
        frames=_frames(trace, stream, (found.sync[missing[k]] for k in begins)),
    )


def _late(trace: Conversation, stream: StreamKey, found: Cycles, late: list[int]) -> Finding:
    """PDOs that come after the next SYNC; their SYNCs by their places."""
    return Finding(
        code="pdo-late",
        severity=Severity.WARNING,
        time=found.sync[late[0]],
        node=stream.node,
        text=f"{stream.name}: after the next SYNC {len(late)} times of {len(found.counts)}",
        frames=_frames(trace, stream, (found.last[k + 1] for k in late)),
    )


def _twice(trace: Conversation, stream: StreamKey, found: Cycles, twice: list[int]) -> Finding:
    """PDOs that come more often than their SYNC; their SYNCs by their places."""
    text = f"{stream.name}: twice for {len(twice)} of {plural(len(found.counts), 'SYNC')}"
    return Finding(
        code="pdo-twice" if stream.name[0] == "T" else "two-hosts",
        severity=Severity.UNRESOLVED,
        time=found.sync[twice[0]],
        node=stream.node,
        text=text,
        frames=_frames(trace, stream, (found.last[k] for k in twice)),
    )


def _find_ended_streams(
    trace: Conversation, stream: StreamKey, known: Sequence[Finding]
) -> Iterator[Finding]:
    """A PDO that ended while SYNC went on, and nobody stopped it."""
    its = trace.observed.streams[stream]
    last = its.time[-1]
    if trace.duration - last < ANSWER_S or is_explained(known, _GAP_CAUSES, stream.node, last):
        return
    stopped = was_commanded(trace, stream.node, last + ANSWER_S, OBEY_S, LEAVING_COMMANDS)
    if stopped or (stream.name[0] == "R" and not has_torque(trace, last)):
        return
    yield Finding(
        code="pdo-missing",
        severity=Severity.UNRESOLVED,
        time=last,
        node=stream.node,
        text=f"{stream.name}: none {trace.lasting(last, None)}",
        frames=(its.frame[-1],),
    )


def _uneven(trace: Conversation, stream: StreamKey, known: Sequence[Finding]) -> Iterator[Finding]:
    """Gaps of a regular PDO that does not come with every SYNC."""
    rhythm = trace.observed.rhythms.get(stream)
    if rhythm is None or not trace.timed:
        return
    over = [
        each
        for each in rhythm.long(LOST_PAUSES)
        if each.end and not is_explained(known, _GAP_CAUSES, stream.node, each.begin)
    ]
    if over:
        worst = trace.span(max((each.end or 0.0) - each.begin for each in over))
        yield Finding(
            code="pdo-missing",
            severity=Severity.RECOVERED,
            time=over[0].begin,
            until=over[-1].end,
            node=stream.node,
            text=f"{stream.name}: none {plural(len(over), 'time')}, for {worst} at worst "
            f"(usually every {trace.span(rhythm.usual)})",
            frames=tuple(each.frame for each in over),
        )
    if rhythm.gaps and rhythm.gaps[-1].end is None:
        yield from _find_ended_streams(trace, stream, known)


def find_wrong_lengths(trace: Conversation, _: Sequence[Finding]) -> Iterator[Finding]:
    """PDOs of a length that others of the same stream do not have."""
    for stream, misfits in trace.observed.misfits.items():
        its = trace.observed.streams[stream]
        good = len(its.time) - len(misfits.time)
        if good < len(misfits.time):
            continue  # its mapping is not known
        until = next((each for each in its.time if each > misfits.time[-1]), None)
        yield Finding(
            code="pdo-length",
            severity=severity_at_end(until),
            time=misfits.time[0],
            until=until,
            node=stream.node,
            text=f"{stream.name}: {len(misfits.time)} of a wrong length",
            frames=tuple(misfits.frame),
        )
