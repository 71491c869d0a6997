"""Findings of SDO transfers: refused, unanswered, overlapping; settings that are not kept."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence

from twin.base.errors import list_first, plural
from twin.devices.akd import protocol
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.findings.finding import (
    Finding,
    Severity,
    is_explained,
    severity_at_end,
)
from twin.devices.akd.object_names import axis_of
from twin.devices.akd.observed import StrayAnswer, Transfer
from twin.devices.akd.protocol import Key

SDO_ANSWER_S, SDO_ANSWER_FRAMES = 0.5, 5
"""What must follow a request in a trace, s or frames, before it counts as without an answer."""
MAX_NAMED = 4
"""Objects that a finding names; of more it has the number."""
TIMED_OUT = 0x0504_0000
"""Abort code of a transfer that took too long."""
_WARNINGS_IF_READ = ("sdo-refused", "sdo-unfinished")
"""Codes of which a transfer that only reads is a warning."""
_SILENCE_CAUSES = ("node-silent", "node-lost", "bus-lost", "boot-up")
"""Codes of findings that explain a transfer without an answer."""
_COMMAND_OBJECTS = {
    0x1003, 0x1010, 0x1011, 0x1F50, 0x1F51, 0x6040, 0x6042, 0x6060, 0x6071, 0x607A, 0x60B0, 0x60B1,
    0x60B2, 0x60C1, 0x60FE, 0x60FF,
}  # fmt: skip
"""Objects that are no settings: what is written commands something, or is shown elsewhere."""


def find_unanswered(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """Requests without an answer, and those that the host gave up."""
    wait = SDO_ANSWER_S if trace.timed else SDO_ANSWER_FRAMES

    def unanswered(each: Transfer) -> bool:
        if each.abort == TIMED_OUT:
            return True
        late = trace.duration - each.begin >= wait
        return each.end is None and late and not each.unfinished

    yield from _group_transfers(trace, known, "sdo-timeout", "without an answer", unanswered)


def find_unfinished(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """Transfers in several frames that the host did not carry on, or gave up."""
    wait = SDO_ANSWER_S if trace.timed else SDO_ANSWER_FRAMES

    def unfinished(each: Transfer) -> bool:
        return each.unfinished and trace.duration - each.begin >= wait

    yield from _group_transfers(trace, known, "sdo-unfinished", "begun, not finished", unfinished)
    yield from _group_aborted(trace, known, "sdo-unfinished", "given up by the host", given_up=True)


def find_refused(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """Requests that were refused; one to read is a warning, as hosts try what there is."""
    yield from _group_aborted(trace, known, "sdo-refused", "refused", given_up=False)


def _group_aborted(
    trace: Conversation, known: Sequence[Finding], code: str, how: str, *, given_up: bool
) -> Iterator[Finding]:
    """Transfers that the device aborted, or that the host gave up, by their abort codes."""
    its = [each for each in trace.observed.transfers if each.given_up is given_up]
    for abort in sorted({each.abort for each in its if each.abort is not None} - {TIMED_OUT}):

        def aborted(each: Transfer, abort: int = abort) -> bool:
            return each.abort == abort and each.given_up is given_up

        words = f"{how}, {protocol.abort_words(abort)}"
        yield from _group_transfers(trace, known, code, words, aborted)


def _group_transfers(
    trace: Conversation,
    known: Sequence[Finding],
    code: str,
    words: str,
    failed: Callable[[Transfer], bool],
) -> Iterator[Finding]:
    """Failed transfers, one finding for each node and severity.

    Args:
        trace: The trace.
        known: What was found before.
        code: Code of the findings.
        words: What became of the transfers.
        failed: Whether a transfer is one of them.
    """
    groups: dict[tuple[int, Severity], list[Transfer]] = {}
    good = {(each.node, each.key, each.writes): each.begin for each in trace.observed.transfers
            if each.good}  # fmt: skip
    for each in trace.observed.transfers:
        if not failed(each) or is_explained(known, _SILENCE_CAUSES, each.node, each.begin):
            continue
        severity = Severity.UNRESOLVED
        if good.get((each.node, each.key, each.writes), -1.0) > each.begin:
            severity = Severity.RECOVERED
        elif code in _WARNINGS_IF_READ and not each.writes:
            severity = Severity.WARNING
        groups.setdefault((each.node, severity), []).append(each)
    for (node, severity), its in groups.items():
        objects = _objects(trace, node, its)
        yield Finding(
            code=code,
            severity=severity,
            time=its[0].begin,
            until=good.get((node, its[-1].key, its[-1].writes))
            if severity is Severity.RECOVERED
            else None,
            node=node,
            axis=_axis(its),
            text=f"{objects}: {words}" + (f", {len(its)} times" if len(its) > 1 else ""),
            frames=tuple(frame for each in its for frame in each.frames),
        )


def _axis(transfers: Sequence[Transfer]) -> int | None:
    """The axis to which all objects belong; None if there is none."""
    axes = {axis_of(each.key[0])[1] if each.key[0] >= 0x6000 else None for each in transfers}
    return axes.pop() if len(axes) == 1 else None


def _objects(trace: Conversation, node: int, transfers: Sequence[Transfer]) -> str:
    """What is read or written, in words."""
    names = dict.fromkeys(
        f"{'writing' if each.writes else 'reading'} {trace.objects.name(node, each.key)}"
        for each in transfers
    )
    return list_first(list(names), MAX_NAMED)


def find_overlaps(trace: Conversation, _: Sequence[Finding]) -> Iterator[Finding]:
    """Requests before the answer to the one before, and answers to no request."""
    nodes = dict.fromkeys(each.node for each in trace.observed.transfers)
    ends: defaultdict[tuple[int, Key], list[float]] = defaultdict(list)
    for each in trace.observed.transfers:
        if each.end is not None:
            ends[each.node, each.key].append(each.end)
    for times in ends.values():
        times.sort()
    for node in nodes:
        its = [each for each in trace.observed.transfers if each.node == node and each.overlapped]
        if its:
            yield Finding(
                code="sdo-overlap",
                severity=Severity.WARNING,
                time=its[0].begin,
                node=node,
                text=f"{_objects(trace, node, its)}: answered after the next request, "
                f"{plural(len(its), 'time')}",
                frames=tuple(frame for each in its for frame in each.frames),
            )
        strays, again = list[StrayAnswer](), list[StrayAnswer]()
        for stray in trace.observed.strays:
            if stray.node == node:
                (again if _is_second(ends[node, stray.key], stray) else strays).append(stray)
        if again:
            yield Finding(
                code="node-twice",
                severity=Severity.UNRESOLVED,
                time=again[0].time,
                node=node,
                text=f"{plural(len(again), 'request')} answered twice",
                frames=tuple(each.frame for each in again),
            )
        if strays:
            names = dict.fromkeys(trace.objects.name(node, each.key) for each in strays)
            yield Finding(
                code="sdo-stray",
                severity=Severity.WARNING,
                time=strays[0].time,
                node=node,
                text=f"{plural(len(strays), 'answer')} that nobody asked for: "
                f"{', '.join(list(names)[:MAX_NAMED])}",
                frames=tuple(each.frame for each in strays),
            )


def find_short_frames(trace: Conversation, _: Sequence[Finding]) -> Iterator[Finding]:
    """SDO frames of fewer than 8 bytes, which CiA 301 does not allow."""
    for node, its in trace.observed.short_transfers.items():
        yield Finding(
            code="sdo-length",
            severity=Severity.WARNING,
            time=its.time[0],
            node=node,
            text=f"{plural(len(its.time), 'SDO frame')} of fewer than 8 bytes",
            frames=tuple(its.frame),
        )


def _is_second(ends: Sequence[float], stray: StrayAnswer) -> bool:
    """Whether an answer is a second one to the same request.

    Args:
        ends: When requests of its object were answered, s, in order.
        stray: The answer.
    """
    before = bisect_right(ends, stray.time)
    return before > 0 and stray.time - ends[before - 1] <= SDO_ANSWER_S


def find_lost_settings(trace: Conversation, _: Sequence[Finding]) -> Iterator[Finding]:
    """Settings that are read back with a different value, or never."""
    written: dict[tuple[int, Key], Transfer] = {}
    unread: dict[tuple[int, Key], Transfer] = {}
    wrong: dict[tuple[int, Key], tuple[Transfer, Transfer]] = {}
    right: dict[tuple[int, Key], float] = {}
    for each in trace.observed.transfers:
        place = each.node, each.key
        if not each.good or each.overlapped or axis_of(each.key[0])[0] in _COMMAND_OBJECTS:
            continue
        if each.writes:
            written[place] = unread[place] = each
            continue
        unread.pop(place, None)
        last = written.get(place)
        if last is None or last.value is None or each.value is None:
            continue
        if protocol.is_kept(each.key[0], last.value, each.value):
            right[place] = each.begin
        else:
            wrong.setdefault(place, (last, each))
    for (node, key), (write, read) in wrong.items():
        until = right.get((node, key))
        until = until if until is not None and until > read.begin else None
        values = [trace.objects.words(node, key, each.value or 0) for each in (write, read)]
        yield Finding(
            code="setting-differs",
            severity=severity_at_end(until),
            time=write.begin,
            until=until,
            node=node,
            axis=_axis([write]),
            text=f"{trace.objects.name(node, key)}: {values[0]} written, {values[1]} read",
            frames=(*write.frames, *read.frames),
        )
    for node in dict.fromkeys(node for node, _ in unread):
        its = sorted(each for (owner, _), each in unread.items() if owner == node)
        names = [trace.objects.name(node, each.key) for each in its]
        yield Finding(
            code="setting-unread",
            severity=Severity.WARNING,
            time=its[0].begin,
            node=node,
            text=f"{plural(len(its), 'setting')} written and never read back: "
            f"{list_first(names, MAX_NAMED)}",
            frames=tuple(each.frames[0] for each in its),
        )
