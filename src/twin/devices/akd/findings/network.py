"""Findings of the network: nodes that are silent or boot, heartbeats, network states, SYNC."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from itertools import pairwise

from twin.base.errors import plural
from twin.devices.akd import protocol
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.findings.drives import has_torque
from twin.devices.akd.findings.finding import (
    KNOWN_BEFORE_S,
    SILENCES,
    Finding,
    Severity,
    is_explained,
    severity_at_end,
)
from twin.devices.akd.observed import BUS, Change, Gap, StreamKey

LOST_PAUSES = 2.5
"""Usual pauses without a heartbeat after which it is lost, not late."""
LOST_SYNCS = 10
"""Periods without SYNC or a PDO after which SYNC or the node is lost."""
ANSWER_S = 0.05
"""Time in s in which a node must have sent something."""
SCANNED_NODES = 10
"""Silent nodes, all asked for nothing but what they are, from which a host only looks for nodes."""
IDENTITY_OBJECTS = (0x1000, 0x1018)
"""Indices of the device type and the identity of a node."""
PAUSE_S, PAUSE_FACTOR, PAUSE_RHYTHMS = 0.2, 20, 10
"""Shortest pause of the whole bus in s; as a factor of the longest but 1 % of all pauses, and of
the slowest regular stream."""
USUAL_SHARE = 0.99
"""Share of all pauses of the bus that are usual."""
RESET_S, OBEY_S = 5.0, 1.0
"""Time in s in which a node boots after a reset, and in which it follows any other NMT command."""
_BOOT_UP, _STOP, _RESETS = 0, 2, (129, 130)
LEAVING_COMMANDS = (_STOP, protocol.PRE_OPERATIONAL, *_RESETS)
"""NMT commands by which a node leaves the operational state."""
_HEARTBEAT, _SYNC = "heartbeat", StreamKey(BUS, "SYNC")


def find_pauses_of_the_bus(trace: Conversation, _: Sequence[Finding]) -> Iterator[Finding]:
    """Times without a frame of anybody."""
    pauses = [after - before for before, after in pairwise(trace.observed.times)]
    if not trace.timed or len(pauses) < LOST_SYNCS:
        return
    slowest = max((each.usual for each in trace.observed.rhythms.values()), default=0.0)
    usual = sorted(pauses)[int(USUAL_SHARE * (len(pauses) - 1))]
    limit = max(PAUSE_S, PAUSE_FACTOR * usual, PAUSE_RHYTHMS * slowest)
    for k in [place for place, pause in enumerate(pauses) if pause > limit]:
        begin, end = trace.observed.times[k], trace.observed.times[k + 1]
        yield Finding(
            code="trace-gap",
            severity=Severity.WARNING,
            time=begin,
            until=end,
            text=f"no frame of anybody for {trace.span(end - begin)}",
            frames=(k + 1, k + 2),
        )


def find_silent_nodes(trace: Conversation, _: Sequence[Finding]) -> Iterator[Finding]:
    """Nodes that are addressed and never send a frame."""
    seen = trace.observed
    asked: dict[int, list[tuple[float, int]]] = {}
    for transfer in seen.transfers:
        asked.setdefault(transfer.node, []).append((transfer.begin, transfer.frames[0]))
    for command in seen.commands:
        asked.setdefault(command.node, []).append((command.time, command.frame))
    for stream, sent in seen.streams.items():
        if stream.name[0] == "R":
            asked.setdefault(stream.node, []).append((sent.time[0], sent.frame[0]))
    silent = {
        node: sorted(times)
        for node, times in sorted(asked.items())
        if node != BUS and not seen.sent_by[node].time
    }
    if trace.timed:
        silent = {n: its for n, its in silent.items() if trace.duration - its[0][0] >= ANSWER_S}
    others = {each.node for each in seen.transfers if each.key[0] not in IDENTITY_OBJECTS}
    others |= {each.node for each in seen.commands}
    others |= {each.node for each in seen.streams}
    scanned = [node for node in silent if node not in others]
    if len(scanned) >= SCANNED_NODES:
        first = silent[scanned[0]][0]
        yield Finding(
            code="node-silent",
            severity=Severity.WARNING,
            time=first[0],
            text=f"a scan of the bus had no answer of {len(scanned)} nodes",
            frames=(first[1],),
        )
        silent = {node: its for node, its in silent.items() if node not in scanned}
    for node, its in silent.items():
        yield Finding(
            code="node-silent",
            severity=Severity.UNRESOLVED,
            time=its[0][0],
            node=node,
            text=f"never sends a frame; it was addressed {len(its)} times"
            if len(its) > 1
            else "never sends a frame, though it was addressed",
            frames=tuple(frame for _, frame in its),
        )


def find_boot_ups(trace: Conversation, _: Sequence[Finding]) -> Iterator[Finding]:
    """Nodes that boot in the middle, without a command or with torque; since their last frame."""
    for node, changes in trace.observed.network.items():
        times, frames = trace.observed.sent_by[node]
        for k, boot in enumerate(changes):
            before = bisect_left(frames, boot.frame) - 1
            if boot.value != _BOOT_UP or before < 0:
                continue
            how, within = "without a command", RESET_S
            if changes[k - 1].value != _BOOT_UP:  # a reset before the last boot-up is answered
                last = (each.time for each in changes[:k] if each.value == _BOOT_UP)
                within = min(within, boot.time - max(last, default=-math.inf))
            if was_commanded(trace, node, boot.time, within, _RESETS):
                how = "by a command, while it had torque"
                if not has_torque(trace, times[before], node):
                    continue
            was = changes[k - 1].value if k else None
            back = next((each for each in changes[k + 1 :] if each.value == was), None)
            good = was != protocol.OPERATIONAL or back is not None
            text = f"booted {how}, {trace.span(boot.time - times[before])} after its "
            text += f"last frame; was {protocol.nmt_words(was)}" if was else "last frame"
            if was == protocol.OPERATIONAL:
                again = f"again after {trace.span(back.time - boot.time)}" if back else "not again"
                text += f", and {again}"
            yield Finding(
                code="boot-up",
                severity=Severity.RECOVERED if good else Severity.UNRESOLVED,
                time=times[before],
                until=back.time if back else None,
                node=node,
                text=text,
                frames=(boot.frame, back.frame) if back else (boot.frame,),
            )


def find_lost_nodes(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """Nodes of which nothing comes for a time, and heartbeats that are lost or late."""
    lost = list[Finding]()
    streams = sorted(trace.observed.rhythms, key=lambda each: each.name != _HEARTBEAT)
    for stream in streams:
        if not stream.node or (stream.name != _HEARTBEAT and stream.name[0] != "T"):
            continue
        pauses = LOST_PAUSES if stream.name == _HEARTBEAT else LOST_SYNCS
        for gap in trace.observed.rhythms[stream].long(pauses):
            silence = _silence(trace, stream.node, gap)
            if silence is None or _is_reset(trace, stream.node, silence):
                continue
            if is_explained([*known, *lost], SILENCES, stream.node, gap.begin):
                continue
            lost.append(_lost_node(trace, stream, silence))
    lost = [each for each in _join_losses(trace, lost) if not _left_in_order(trace, each)]
    yield from lost
    for stream in streams:
        if stream.name == _HEARTBEAT:
            yield from _heartbeats(trace, stream, [*known, *lost])


def _join_losses(trace: Conversation, lost: list[Finding]) -> list[Finding]:
    """Losses of nodes; those of all nodes but the host at the same time are one of the bus."""
    devices = {number for number, node in trace.nodes.items() if node.frames.keys() - {_HEARTBEAT}}
    fastest: dict[int, float] = {}
    for stream, rhythm in trace.observed.rhythms.items():
        fastest[stream.node] = min(rhythm.usual, fastest.get(stream.node, rhythm.usual))
    apart = KNOWN_BEFORE_S + max((fastest.get(each, 0.0) for each in devices), default=0.0)
    together = list[Finding]()
    for each in lost:
        same = [other for other in lost if abs(other.time - each.time) <= apart]
        if len(devices) > 1 and {other.node for other in same} >= devices:
            together = same
            break
    if not together:
        return lost
    first = min(together, key=lambda each: each.time)
    names = " and ".join(trace.called(node) for node in sorted({each.node for each in together}))
    untils = [each.until for each in together if each.until is not None]
    until = max(untils) if len(untils) == len(together) else None
    bus = Finding(
        code="bus-lost",
        severity=severity_at_end(until),
        time=first.time,
        until=until,
        text=f"no frame of {names} {trace.lasting(first.time, until)}",
        frames=tuple(frame for each in together for frame in each.frames),
    )
    rest = [each for each in lost if each not in together]
    return [
        bus,
        *(each for each in rest if not is_explained([bus], ("bus-lost",), BUS, each.time)),
    ]


def _lost_node(trace: Conversation, stream: StreamKey, silence: Gap) -> Finding:
    """A node is silent for a time, as a regular stream of it shows."""
    lasting = trace.lasting(silence.begin, silence.end)
    usual = trace.span(trace.observed.rhythms[stream].usual)
    return Finding(
        code="node-lost",
        severity=severity_at_end(silence.end),
        time=silence.begin,
        until=silence.end,
        node=stream.node,
        text=f"no frame {lasting} ({stream.name} usually every {usual})",
        frames=(silence.frame,),
    )


def _silence(trace: Conversation, node: int, gap: Gap) -> Gap | None:
    """The silence of a node around a gap of one of its streams; None if it sends something else."""
    times, frames = trace.observed.sent_by[node]
    last = bisect_right(times, gap.begin)
    after = times[last] if last < len(times) else None
    if after is not None and (gap.end is None or after < gap.end):
        return None
    return Gap(gap.begin, after, frames[last - 1])


def _left_in_order(trace: Conversation, lost: Finding) -> bool:
    """Whether a node that is lost to the end is the host, which ends while no drive has torque."""
    if not lost.node or lost.until is not None or has_torque(trace, lost.time):
        return False
    if trace.nodes[lost.node].frames.keys() - {_HEARTBEAT}:
        return False
    host = [its.time[-1] for key, its in trace.observed.streams.items() if key.name[0] in "RS"]
    return bool(host) and max(host) < trace.duration - ANSWER_S


def _heartbeats(
    trace: Conversation, stream: StreamKey, known: Sequence[Finding]
) -> Iterator[Finding]:
    """Heartbeats that are lost or late while the node sends other frames."""
    rhythm = trace.observed.rhythms[stream]
    gaps = [
        each
        for each in rhythm.gaps
        if not is_explained(known, SILENCES, stream.node, each.begin)
        and not (each.end and is_explained(known, SILENCES, stream.node, each.end))
        and not _is_reset(trace, stream.node, each)
    ]
    lost = [each for each in rhythm.long(LOST_PAUSES) if each in gaps]
    late = [each for each in gaps if each not in lost]
    usual = f"usually every {trace.span(rhythm.usual)}"
    over, to_the_end = (
        [each for each in lost if (each.end is None) is end] for end in (False, True)
    )
    found = ("heartbeat-lost", to_the_end), ("heartbeat-lost", over), ("heartbeat-late", late)
    for code, its in found:
        if not its:
            continue
        lengths = [trace.end_of(each.end) - each.begin for each in its]
        last = its[-1].end
        often = "to the end of the trace, " if last is None else ""
        often += f"{len(its)} times, at worst " if len(its) > 1 else ""
        text = f"no heartbeat {often}for {trace.span(max(lengths))}"
        watch = _describe_watch(trace, stream.node, max(lengths))
        yield Finding(
            code=code,
            severity=Severity.WARNING if code == "heartbeat-late" else severity_at_end(last),
            time=its[0].begin,
            until=last,
            node=stream.node,
            text=f"{text} ({usual}){watch}",
            frames=tuple(each.frame for each in its),
        )


def _describe_watch(trace: Conversation, node: int, silence: float) -> str:
    """Who watches a node and allows a shorter silence, in words."""
    watches = (
        (watcher, *protocol.split_watch(value))
        for watcher, values in sorted(trace.objects.values.items())
        for (index, sub), value in values.items()
        if index == protocol.CONSUMER_HEARTBEAT and sub
    )
    limits = [
        f"node {watcher} allows {allowed} ms"
        for watcher, watched, allowed in watches
        if watched == node and 0 < allowed < 1e3 * silence
    ]
    return f"; {', '.join(limits)}" if limits else ""


def find_wrong_network_states(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """Nodes that leave the operational state without a command, or do not follow a start."""
    for node, changes in trace.observed.network.items():
        for before, now in pairwise(changes):
            if before.value != protocol.OPERATIONAL or now.value == _BOOT_UP:
                continue
            if was_commanded(trace, node, now.time, OBEY_S, LEAVING_COMMANDS):
                continue
            if is_explained(known, ("boot-up",), node, now.time):
                continue
            back = _next_operational(changes, now.time)
            until = back.time if back else None
            yield Finding(
                code="nmt-left",
                severity=severity_at_end(until),
                time=now.time,
                until=until,
                node=node,
                text=f"left operational without a command, is {protocol.nmt_words(now.value)}",
                frames=(now.frame, back.frame) if back else (now.frame,),
            )
    yield from _ignored_starts(trace)


def _next_operational(changes: Sequence[Change], time: float) -> Change | None:
    """Where a node next becomes operational, after a time in s; None if it does not."""
    after = (each for each in changes if each.time > time)
    return next((each for each in after if each.value == protocol.OPERATIONAL), None)


def _ignored_starts(trace: Conversation) -> Iterator[Finding]:
    """Starts that a node with heartbeats does not follow."""
    for k, command in enumerate(trace.observed.commands):
        if command.command != protocol.START or not trace.timed:
            continue
        for node, changes in trace.observed.network.items():
            rhythm = trace.observed.rhythms.get(StreamKey(node, _HEARTBEAT))
            if command.node not in (BUS, node) or rhythm is None:
                continue
            limit = command.time + OBEY_S + LOST_PAUSES * rhythm.usual
            later = [each for each in trace.observed.commands[k + 1 :] if each.node in (BUS, node)]
            if limit > min([trace.duration, *(each.time for each in later)]):
                continue
            states = [each for each in changes if each.time <= limit]
            started = any(each.value == protocol.OPERATIONAL for each in states[-1:]) or any(
                each.value == protocol.OPERATIONAL and each.time > command.time for each in states
            )
            if started or not states:
                continue
            back = _next_operational(changes, limit)
            until = back.time if back else None
            yield Finding(
                code="nmt-ignored",
                severity=severity_at_end(until),
                time=command.time,
                until=until,
                node=node,
                text=f"did not follow the start, is {protocol.nmt_words(states[-1].value)}",
                frames=(command.frame, states[-1].frame),
            )


def find_late_sync(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """SYNC that is lost, or late."""
    rhythm = trace.observed.rhythms.get(_SYNC)
    if rhythm is None:
        return
    gaps = [
        each for each in rhythm.gaps if not is_explained(known, ("trace-gap",), BUS, each.begin)
    ]
    lost = [each for each in rhythm.long(LOST_SYNCS) if each in gaps]
    usual = f"usually every {trace.span(rhythm.usual)}"
    for gap in lost:
        if gap.end is None and not has_torque(trace, gap.begin):
            continue  # the host ends, as it may
        torque = ", while a drive has torque" if has_torque(trace, gap.begin) else ""
        yield Finding(
            code="sync-lost",
            severity=severity_at_end(gap.end),
            time=gap.begin,
            until=gap.end,
            text=f"no SYNC {trace.lasting(gap.begin, gap.end)} ({usual}){torque}",
            frames=(gap.frame,),
        )
    late = [each for each in gaps if each not in lost and each.end is not None]
    if late:
        worst = trace.span(max((each.end or each.begin) - each.begin for each in late))
        yield Finding(
            code="sync-late",
            severity=Severity.WARNING,
            time=late[0].begin,
            until=late[-1].end,
            text=f"SYNC late {plural(len(late), 'time')}, after {worst} at worst ({usual})",
            frames=tuple(each.frame for each in late),
        )


def _is_reset(trace: Conversation, node: int, gap: Gap) -> bool:
    """Whether a node came back after a gap in which it was reset."""
    if gap.end is None:
        return False
    return was_commanded(trace, node, gap.end, gap.end - gap.begin, _RESETS)


def was_commanded(
    trace: Conversation, node: int, time: float, within: float, commands: Sequence[int]
) -> bool:
    """Whether the host sent a node one of some NMT commands within some s before a time.

    Without times it is whether it sent one at all.
    """
    times = [each.time for each in trace.observed.commands]
    earliest = time - within if trace.timed else 0.0
    first, last = bisect_left(times, earliest), bisect_right(times, time)
    return any(
        each.command in commands and each.node in (BUS, node)
        for each in trace.observed.commands[first:last]
    )
