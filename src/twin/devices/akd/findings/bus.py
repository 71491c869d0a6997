"""Findings of the bus: error frames, several hosts, its load, node guarding, a clock set back."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from statistics import fmean, median

from twin.base.errors import plural
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.findings.finding import (
    Finding,
    Severity,
    is_explained,
    severity_at_end,
)
from twin.devices.akd.observed import BUS, StreamKey
from twin.devices.akd.wire_values import BUS_OFF

LOAD_WINDOW_S = 0.1
"""Time in s over which the load of the bus is taken."""
TIME_ROUNDING = 1e-6
"""Share of such a window by which a time may be rounded."""
HIGH_LOAD = 0.8
"""Share of the bit rate above which a bus is full."""
GUARD_ANSWER_S = 0.1
"""Time in s that a node has to answer a guard request."""
MIN_PAIRS = 5
"""Frames in a row by which two senders of the same identifier are distinguished from one."""
PAIR_SHARE = 1.3
"""Usual pauses within which the next but one comes if there are two senders."""
UNEVEN_SHARE, CLOSE_SHARE, REGULAR_SHARE = 0.6, 0.2, 0.1
"""Of two interleaved senders: difference of neighbouring pauses at least, where the period of one
sender is not known and where it is, and difference of sums at most, as shares of their sum."""
_HOST_ALONE = "another sender has an identifier of the host"


def find_error_frames(trace: Conversation, _: Sequence[Finding]) -> Iterator[Finding]:
    """Error frames: bus off, and all others."""
    errors = trace.observed.error_frames
    off = [each for each in errors if each.classes & BUS_OFF]
    if off:
        devices = [node for node, its in trace.nodes.items() if its.frames.keys() - {"heartbeat"}]
        later = (trace.observed.sent_by[node].time for node in devices)
        again = [each for each in later if each and each[-1] > off[-1].time]
        yield Finding(
            code="bus-off",
            severity=Severity.RECOVERED if again else Severity.UNRESOLVED,
            time=off[0].time,
            text=f"the controller left the bus (bus off), {plural(len(off), 'time')}",
            frames=tuple(each.frame for each in off),
        )
    others = [each for each in errors if not each.classes & BUS_OFF]
    if others:
        counts = Counter(each.words for each in others)
        words = ", ".join(f"{count} {what}" for what, count in counts.most_common())
        yield Finding(
            code="error-frames",
            severity=Severity.WARNING,
            time=others[0].time,
            text=f"{plural(len(others), 'error frame')}: {words}",
            frames=tuple(each.frame for each in others),
        )


def find_other_hosts(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """Frames of the host that somebody else sends, too; SYNC and heartbeats of two senders."""
    foreign = trace.observed.foreign
    if foreign:
        yield Finding(
            code="two-hosts",
            severity=Severity.UNRESOLVED,
            time=trace.observed.times[foreign[0] - 1],
            text=f"{_HOST_ALONE}, {plural(len(foreign), 'frame')}",
            frames=tuple(foreign),
        )
    for stream, its in trace.observed.streams.items():
        sync = stream == StreamKey(BUS, "SYNC")
        if not trace.timed or not (sync or stream.name == "heartbeat"):
            continue
        rhythm = trace.observed.rhythms.get(stream)
        given = trace.objects.values[stream.node].get((0x1017, 0), 0) / 1e3 if stream.node else 0.0
        usual = max(given, rhythm.usual if rhythm else 0.0)
        place = first_of_two(its.time, usual)
        if place is None or (sync and foreign):
            continue
        if is_explained(known, ("trace-gap",), BUS, its.time[place]):
            continue  # what has waited is read at once
        yield Finding(
            code="two-hosts" if sync else "node-twice",
            severity=Severity.UNRESOLVED,
            time=its.time[place],
            node=stream.node,
            text="SYNC of two senders" if sync else "heartbeats of two senders",
            frames=tuple(its.frame[place : place + MIN_PAIRS]),
        )


def first_of_two(time: Sequence[float], usual: float) -> int | None:
    """Where frames of a second sender with the same identifier begin; None if there is none.

    Frames of two senders come in pairs of uneven pauses; their sum is the period of each sender.
    One sender that is late every other time looks alike; its mean pause is its usual one, though.

    Args:
        time: Of the frames, s.
        usual: The pause of one sender, s; 0 if it is not known.
    """
    if len(time) < 2 * MIN_PAIRS:
        return None
    pauses = [after - before for before, after in pairwise(time)]
    for k in range(0, len(pauses) - MIN_PAIRS, MIN_PAIRS):
        block = pauses[k : k + MIN_PAIRS]
        if max(block) - min(block) < REGULAR_SHARE * fmean(block):
            usual = max(usual, fmean(block))
    pairs = [(one + other, abs(one - other)) for one, other in pairwise(pauses)]
    both = median(together for together, _ in pairs)
    found = _first_run(
        together < PAIR_SHARE * usual and apart > CLOSE_SHARE * together
        for together, apart in pairs
    )
    if found is not None or abs(2 * median(pauses) - both) <= UNEVEN_SHARE * both:
        return found
    return _first_run(
        apart > UNEVEN_SHARE * both and abs(together - both) < REGULAR_SHARE * both
        for together, apart in pairs
    )


def _first_run(holds: Iterable[bool]) -> int | None:
    """Where something first holds ``MIN_PAIRS`` times in a row; None if it never does."""
    count = 0
    for place, each in enumerate(holds):
        count = count + 1 if each else 0
        if count == MIN_PAIRS:
            return place - MIN_PAIRS + 1
    return None


def find_high_load(trace: Conversation, _: Sequence[Finding]) -> Iterator[Finding]:
    """A bus that is nearly full, where its bit rate is known."""
    if trace.bitrate is None or not trace.timed:
        return
    begin, load = busiest(trace)
    if load > HIGH_LOAD * trace.bitrate:
        yield Finding(
            code="bus-load",
            severity=Severity.WARNING,
            time=begin,
            text=f"up to {100 * load / trace.bitrate:.0f} % of {trace.bitrate} bit/s are taken "
            f"within {trace.span(LOAD_WINDOW_S)}",
            frames=(bisect_left(trace.observed.times, begin) + 1,),
        )


def busiest(trace: Conversation) -> tuple[float, float]:
    """When the bus is busiest, s, and its load then in bit/s, stuffed as badly as can be."""
    loads = defaultdict[int, float](float)
    for time, bits in zip(trace.observed.times, trace.observed.bits, strict=True):
        loads[int(time / LOAD_WINDOW_S + TIME_ROUNDING)] += bits
    if len(loads) > 1:
        del loads[max(loads)]  # the last is no whole one
    place = max(loads, key=lambda each: loads[each])
    return place * LOAD_WINDOW_S, loads[place] / LOAD_WINDOW_S


def find_guarding(trace: Conversation, _: Sequence[Finding]) -> Iterator[Finding]:
    """Guard requests that a node does not answer, and toggle bits that do not alternate."""
    for node, guards in trace.observed.guards.items():
        life = trace.observed.life.get(node, [])
        times = [each.time for each in life]
        unanswered, answers = list[int](), dict[int, int]()
        ends = [*guards.time[1:], trace.duration]
        for k, (begin, end) in enumerate(zip(guards.time, ends, strict=True)):
            after = bisect_right(times, begin)
            if after < len(times) and times[after] <= end:
                answers[k] = after
            elif end - begin >= GUARD_ANSWER_S or k + 1 < len(guards.time):
                unanswered.append(k)
        if unanswered:
            until = next((guards.time[k] for k in answers if k > unanswered[-1]), None)
            yield Finding(
                code="guard-unanswered",
                severity=severity_at_end(until),
                time=guards.time[unanswered[0]],
                until=until,
                node=node,
                text=f"{len(unanswered)} of {plural(len(guards.time), 'guard request')} without "
                "an answer",
                frames=tuple(guards.frame[k] for k in unanswered),
            )
        stuck = [
            life[now]
            for before, now in pairwise(answers.values())
            if now == before + 1 and not (life[now].value ^ life[before].value) & 0x80
        ]
        if stuck:
            yield Finding(
                code="guard-toggle",
                severity=Severity.WARNING,
                time=stuck[0].time,
                node=node,
                text=f"the toggle bit does not alternate, {plural(len(stuck), 'time')}",
                frames=tuple(each.frame for each in stuck),
            )


def find_clock_steps(remarks: Sequence[str]) -> Iterator[Finding]:
    """A clock that was set back, as the remarks on a trace have it."""
    for remark in remarks:
        _, back, rest = remark.partition("time goes back")
        if back:
            yield Finding(
                code="time-back",
                severity=Severity.WARNING,
                time=0.0,
                text=f"{back}{rest}",
                frames=(),
            )
