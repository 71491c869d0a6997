"""Findings of drives that do not do what they are commanded: torque, states, modes, set-points."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple, TypeVar

from twin.base.errors import plural
from twin.devices.akd import protocol
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.findings.drives import FAULTY, Axis, Span, axes, rising
from twin.devices.akd.findings.finding import (
    SILENCES,
    Finding,
    Severity,
    causes_of_error,
    is_explained,
    severity_at_end,
)
from twin.devices.akd.findings.motion import coasting
from twin.devices.akd.findings.network import LEAVING_COMMANDS, OBEY_S, was_commanded
from twin.devices.akd.object_names import MODE_OBJECTS, STATUS, key_of_axis
from twin.devices.akd.observed import Change
from twin.devices.akd.protocol import DriveState

Held = TypeVar("Held")

FOLLOW_S = 0.1
"""Time in s for which a drive may not follow its cyclic command."""
WORKS_ON_S = 0.5
"""Time in s for which a drive stays enabled after an emergency that is only a warning."""
FOLLOWING_ERROR, FOLLOWING_WINDOW, NO_WINDOW = 0x60F4, 0x6065, 0xFFFF_FFFF
"""The following error of an axis, its window, and the value that means no window."""
NEW_SETPOINT = 1 << 4
"""Bit of the control word: a new set-point, or the start of homing."""
PROFILE_POSITION, HOMING, CYCLIC = 1, 6, (8, 9, 10)
"""Modes of operation."""
_STATES_BY_COMMAND = {
    "shutdown": (DriveState.READY,),
    "switch on": (DriveState.SWITCHED_ON,),
    "enable operation": (DriveState.OPERATION_ENABLED,),
}
"""States that a drive reaches by a command."""
_NEEDED_COMMANDS = {
    (DriveState.SWITCH_ON_DISABLED, "switch on"): "needs shutdown (0006h) first",
    (DriveState.SWITCH_ON_DISABLED, "enable operation"): "needs shutdown (0006h) first",
    (DriveState.READY, "enable operation"): "needs switch on (0007h) first",
}
"""The command that must come first, by state and command."""


def find_lost_torque(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """Axes that leave operation enabled without a command, and without a fault."""
    for axis in axes(trace):
        for before, now in pairwise(axis.spans):
            control = axis.control_at(now.begin)
            if before.state is not DriveState.OPERATION_ENABLED or now.state in FAULTY:
                continue
            if control is None or not protocol.control_words(control).startswith("enable"):
                continue
            if was_commanded(trace, axis.node, now.begin, OBEY_S, LEAVING_COMMANDS):
                continue
            if is_explained(known, SILENCES, axis.node, now.begin):
                continue
            back = _next(axis, now.begin, (DriveState.OPERATION_ENABLED,))
            yield Finding(
                code="torque-lost",
                severity=severity_at_end(back),
                time=now.begin,
                until=back,
                node=axis.node,
                axis=axis.number,
                text=f"left operation enabled without a command, is {now.state.value}",
                motion=coasting(trace, axis.node, axis.number, now.begin, trace.end_of(back)),
                frames=(now.frame,),
            )


def _next(axis: Axis, time: float, states: Sequence[DriveState]) -> float | None:
    """When an axis next is in one of some states, after a time in s; None if it is not."""
    found = (each.begin for each in axis.spans if each.state in states and each.begin > time)
    return next(found, None)


def find_ignored_commands(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """Commands that an axis does not follow: it is in the wrong state, or something is missing."""
    if not trace.timed:
        return
    for axis in axes(trace):
        for time, words, frame, end in _commands(axis, trace.duration):
            reached = _STATES_BY_COMMAND.get(words)
            begun, last = axis.span_at(time), axis.span_at(end)
            if reached is None or begun is None or last is None or end - time < OBEY_S:
                continue
            if any(each.state in (*reached, *FAULTY) for each in _between(axis, time, end)):
                continue
            if is_explained(known, SILENCES, axis.node, time):
                continue
            until = _next(axis, time, reached)
            why = _NEEDED_COMMANDS.get((begun.state, words), "the drive is not released")
            yield Finding(
                code="wrong-state",
                severity=severity_at_end(until),
                time=time,
                until=until,
                node=axis.node,
                axis=axis.number,
                text=f"{words} without effect for {trace.span(end - time)}: "
                f"{last.state.value}, {why}",
                frames=(frame, last.frame),
            )


def _commands(axis: Axis, end: float) -> Iterator[tuple[float, str, int, float]]:
    """The commands to an axis: time, words, frame, and until when in s they stand."""
    kinds = [
        (each.time, protocol.control_words(each.value).partition(",")[0], each.frame)
        for each in axis.controls
    ]
    kinds = [each for k, each in enumerate(kinds) if not k or each[1] != kinds[k - 1][1]]
    for k, (time, words, frame) in enumerate(kinds):
        yield time, words, frame, kinds[k + 1][0] if k + 1 < len(kinds) else end


def _between(axis: Axis, begin: float, end: float) -> Iterator[Span]:
    """The states of an axis between two times in s."""
    for each in axis.spans:
        if each.begin <= end and (each.end is None or each.end > begin):
            yield each


def find_wrong_modes(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """Axes that display a different mode of operation from the one given."""
    if not trace.timed:
        return
    for axis in axes(trace):
        shown, given = (
            trace.observed.changes.get((axis.node, key_of_axis(index, axis.number)), [])
            for index in MODE_OBJECTS
        )
        for begin, end, (mode, wanted, frame) in _stretches(_mismatches(shown, given)):
            span = axis.span_at(begin)
            enabled = span is not None and span.state is DriveState.OPERATION_ENABLED
            sudden = enabled and not any(begin - OBEY_S <= each.time <= begin for each in given)
            lasted = trace.end_of(end) - begin
            if not (sudden or lasted >= OBEY_S):
                continue
            if is_explained(known, SILENCES, axis.node, begin):
                continue
            names = [
                trace.objects.words(axis.node, (MODE_OBJECTS[0], 0), each)
                for each in (mode, wanted)
            ]
            yield Finding(
                code="mode-differs",
                severity=severity_at_end(end),
                time=begin,
                until=end,
                node=axis.node,
                axis=axis.number,
                text=f"is in {names[0]} for {trace.span(lasted)}, given is {names[1]}",
                frames=(frame,),
            )


def _mismatches(
    shown: Sequence[Change], given: Sequence[Change]
) -> Iterator[tuple[float, tuple[int, int, int] | None]]:
    """At each change of a mode: mode, the given one and frame if these differ, else None."""
    mode: int | None = None
    wanted: int | None = None
    changes = sorted([(each, True) for each in shown] + [(each, False) for each in given])
    for change, is_shown in changes:
        mode, wanted = (change.value, wanted) if is_shown else (mode, change.value)
        if mode is None or wanted is None or mode == wanted:
            yield change.time, None
        else:
            yield change.time, (mode, wanted, change.frame)


def _stretches(
    seen: Iterable[tuple[float, Held | None]],
) -> Iterator[tuple[float, float | None, Held]]:
    """Where something stands: begin and end in s (None: to the end), and its first value.

    Args:
        seen: Times in s, and what stands from each on; None for nothing.
    """
    found: tuple[float, Held] | None = None
    for time, what in seen:
        if found is None and what is not None:
            found = time, what
        elif found is not None and what is None:
            yield found[0], time, found[1]
            found = None
    if found is not None:
        yield found[0], None, found[1]


class Flag(NamedTuple):
    """A bit of the status word that is a finding while it is set, or while it is not.

    Attributes:
        code: Of the finding.
        mask: The bit.
        set: Whether it is a finding where it is set.
        modes: In which modes of operation; empty for all.
        lasting: Whether the axis works wrongly meanwhile; else it only warns.
        text: In words.
        after: Time in s that it may last.
    """

    code: str
    mask: int
    set: bool
    modes: tuple[int, ...]
    lasting: bool
    text: str
    after: float = 0.0


STATUS_FLAGS = (
    Flag("limit-active", 1 << 11, True, (), False, "internal limit active"),
    Flag("drive-warning", 1 << 7, True, (), False, "the drive warns"),
    Flag("no-voltage", 1 << 4, False, (), True, "no main voltage"),
    Flag("not-remote", 1 << 9, False, (), True, "not under remote control"),
    Flag("following-error", 1 << 13, True, (PROFILE_POSITION, 8), True, "following error"),
    Flag("slippage", 1 << 13, True, (protocol.PROFILE_VELOCITY,), True, "maximum slippage"),
    Flag("homing-error", 1 << 13, True, (HOMING,), True, "homing error"),
    Flag("not-following", 1 << 12, False, CYCLIC, True, "does not follow the command", FOLLOW_S),
)
"""Bits of the status word, while an axis is enabled."""


def find_flags(trace: Conversation, _: Sequence[Finding]) -> Iterator[Finding]:
    """What the status word of an enabled axis warns of, by its mode of operation."""
    for axis in axes(trace):
        words = trace.observed.changes[axis.node, key_of_axis(STATUS, axis.number)]
        for flag in STATUS_FLAGS:
            times = [
                each
                for each in _stretches(_frames_of(trace, axis, words, flag))
                if trace.end_of(each[1]) - each[0] >= flag.after
            ]
            if not times:
                continue
            until = times[-1][1]
            total = sum(trace.end_of(end) - begin for begin, end, _ in times)
            often = f", {len(times)} times" if len(times) > 1 else ""
            yield Finding(
                code=flag.code,
                severity=severity_at_end(until) if flag.lasting else Severity.WARNING,
                time=times[0][0],
                until=until,
                node=axis.node,
                axis=axis.number,
                text=f"{flag.text} for {trace.span(total)}{often}",
                frames=tuple(frame for _, _, frame in times),
            )


def _frames_of(
    trace: Conversation, axis: Axis, words: Sequence[Change], flag: Flag
) -> Iterator[tuple[float, int | None]]:
    """At each status word: its frame if a flag stands while the axis is enabled, else None."""
    served = False
    for each in words:
        is_set = bool(each.value & flag.mask)
        served |= is_set
        stands = (
            served
            and is_set is flag.set
            and protocol.state(each.value) is DriveState.OPERATION_ENABLED
            and (
                not flag.modes
                or trace.objects.mode(axis.node, axis.number, each.time) in flag.modes
            )
        )
        yield each.time, each.frame if stands else None


def find_following_errors(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """Following errors in PDOs that leave the window of the drive, which the trace has."""
    flagged = {(each.node, each.axis) for each in known if each.code == "following-error"}
    for axis in axes(trace):
        window = trace.objects.values[axis.node].get(key_of_axis(FOLLOWING_WINDOW, axis.number))
        series = trace.series.get((axis.node, key_of_axis(FOLLOWING_ERROR, axis.number)))
        if not window or window == NO_WINDOW or series is None:
            continue
        outside = [k for k, count in enumerate(series.counts) if abs(count) > window]
        if not outside or (axis.node, axis.number) in flagged:
            continue
        last = outside[-1] + 1
        until = series.time[last] if last < len(series.time) else None
        worst = max(abs(series.counts[k]) for k in outside)
        begin = series.time[outside[0]]
        yield Finding(
            code="following-error",
            severity=severity_at_end(until),
            time=begin,
            until=until,
            node=axis.node,
            axis=axis.number,
            text=f"following error up to {worst}, its window is {window}",
            frames=(bisect_left(trace.observed.times, begin) + 1,),
        )


def find_missed_targets(trace: Conversation, _: Sequence[Finding]) -> Iterator[Finding]:
    """Set-points that are not acknowledged or not reached, and homing that does not end."""
    if not trace.timed:
        return
    for axis in axes(trace):
        words = trace.observed.changes[axis.node, key_of_axis(STATUS, axis.number)]
        times = [each.time for each in words]
        starts = rising(axis.controls, NEW_SETPOINT)
        for k, start in enumerate(starts):
            mode = trace.objects.mode(axis.node, axis.number, start.time)
            end = starts[k + 1].time if k + 1 < len(starts) else trace.duration
            if mode not in (PROFILE_POSITION, HOMING) or end - start.time < OBEY_S:
                continue
            first, after = bisect_right(times, start.time), bisect_right(times, end)
            during = words[first:after]
            seen = during or words[max(first - 1, 0) : first]
            acknowledged = any(each.value & protocol.MODE_BIT for each in seen)
            reached = any(each.value & protocol.TARGET_REACHED for each in during)
            if acknowledged and (reached or mode == HOMING):
                continue
            code, text = "target-missed", "the target of a set-point is not reached"
            if mode == HOMING:
                text = "homing is not attained"
            elif not acknowledged:
                code, text = "setpoint-ignored", "a set-point is not acknowledged"
            until = None if k == len(starts) - 1 else end
            yield Finding(
                code=code,
                severity=severity_at_end(until),
                time=start.time,
                until=until,
                node=axis.node,
                axis=axis.number,
                text=f"{text} within {trace.span(end - start.time)}",
                frames=(start.frame,),
            )


def _works_on(trace: Conversation, node: int, time: float) -> bool:
    """Whether an axis of a node is enabled at a time in s and for a while after it."""
    for axis in axes(trace):
        span = axis.span_at(time)
        if axis.node != node or span is None or span.state is not DriveState.OPERATION_ENABLED:
            continue
        series = trace.series.get((node, key_of_axis(STATUS, axis.number)))
        shown = series.time[-1] if series and series.time else span.begin
        if min(shown, trace.end_of(span.end)) - time >= WORKS_ON_S:
            return True
    return False


def find_emergencies(trace: Conversation, known: Sequence[Finding]) -> Iterator[Finding]:
    """Emergencies that belong to no fault of a drive."""
    explained = {frame for each in known for frame in each.frames if each.code == "drive-fault"}
    groups: dict[tuple[int, int | None], list[int]] = {}
    for k, each in enumerate(trace.observed.emergencies):
        if each.code != 0 and each.frame not in explained:
            groups.setdefault((each.node, each.code), []).append(k)
    for (node, code), places in groups.items():
        its = [trace.observed.emergencies[k] for k in places]
        cleared = (
            each.time
            for each in trace.observed.emergencies[places[-1] + 1 :]
            if each.node == node and each.code == 0
        )
        until = next(cleared, None)
        severity = severity_at_end(until)
        if until is None and _works_on(trace, node, its[-1].time):
            severity = Severity.WARNING
        yield Finding(
            code="emergency",
            severity=severity,
            time=its[0].time,
            until=until,
            node=node,
            text=f"emergency {its[0].words}"
            + (f", {plural(len(its), 'time')}" if len(its) > 1 else "")
            + (", then cleared" if until is not None else ""),
            frames=tuple(each.frame for each in its),
            seen=causes_of_error(code) if code else (),
        )
