"""Findings of drives: faults, resets, lost torque, states that do not follow the command."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple
from weakref import WeakKeyDictionary

from twin.base.errors import plural
from twin.devices.akd import protocol
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.findings.finding import Finding, causes_of_error, severity_at_end
from twin.devices.akd.findings.motion import coasting
from twin.devices.akd.object_names import CONTROL, ERROR_CODE, FAULTS, STATUS, axis_of, key_of_axis
from twin.devices.akd.observed import BUS, Change
from twin.devices.akd.protocol import DriveState

RESET_S = 1.0
"""Time in s that a fault reset may take."""
ANSWER_FIRST_S = 0.02
"""Time in s by which a trace may have an answer before the command, as PDOs wait for SYNC."""
REPORT_BEFORE_S, REPORT_AFTER_S = 0.1, 0.5
"""How long before and after a fault an emergency or an error code belongs to it, s."""
FAULTY = {DriveState.FAULT, DriveState.FAULT_REACTION}
"""States of a drive in fault."""


class Span(NamedTuple):
    """A state of an axis: since when and until when in s (None: to the end), and its frame."""

    state: DriveState
    begin: float
    end: float | None
    frame: int


class Axis(NamedTuple):
    """An axis of a drive: its states and control words over time.

    Attributes:
        node: The drive.
        number: 1 for the first axis.
        spans: Its states in their order.
        controls: Changes of its control word.
    """

    node: int
    number: int
    spans: list[Span]
    controls: list[Change]

    def span_at(self, time: float) -> Span | None:
        """The state at a time in s; None before the first is known."""
        return next((each for each in reversed(self.spans) if each.begin <= time), None)

    def control_at(self, time: float) -> int | None:
        """The control word at a time in s; None before the first is known."""
        found = (each.value for each in reversed(self.controls) if each.time <= time)
        return next(found, None)

    @property
    def resets(self) -> list[Change]:
        """Its fault resets."""
        return rising(self.controls, protocol.RESET)


_axes_of: WeakKeyDictionary[Conversation, tuple[Axis, ...]] = WeakKeyDictionary()
"""The axes of traces in use, which nearly every family of findings needs."""


def axes(trace: Conversation) -> tuple[Axis, ...]:
    """The axes of all drives of a trace."""
    if trace not in _axes_of:
        _axes_of[trace] = tuple(_find_axes(trace))
    return _axes_of[trace]


def _find_axes(trace: Conversation) -> Iterator[Axis]:
    """The axes with a known status word."""
    for (node, (index, sub)), changes in trace.observed.changes.items():
        base, number = axis_of(index)
        if base != STATUS or sub or not trace.objects.is_drive(node):
            continue
        spans = list[Span]()
        for each in changes:
            state = protocol.state(each.value)
            if spans and spans[-1].state is state:
                continue
            if spans:
                spans[-1] = spans[-1]._replace(end=each.time)
            spans.append(Span(state, each.time, None, each.frame))
        controls = trace.observed.changes.get((node, key_of_axis(CONTROL, number)), [])
        yield Axis(node, number, spans, controls)


def find_faults(trace: Conversation, _: Sequence[Finding]) -> Iterator[Finding]:
    """Drives in fault, and resets without effect."""
    for axis in axes(trace):
        for k, first in enumerate(axis.spans):
            if first.state not in FAULTY or (k and axis.spans[k - 1].state in FAULTY):
                continue
            rest = axis.spans[k:]
            after = next((each for each in rest if each.state not in FAULTY), None)
            yield from _fault(trace, axis, first, after.begin if after else None)


def _fault(trace: Conversation, axis: Axis, first: Span, until: float | None) -> Iterator[Finding]:
    """A fault of an axis, and the resets without effect during it."""
    end = trace.end_of(until)
    resets = [each for each in axis.resets if first.begin <= each.time <= end + ANSWER_FIRST_S]
    worked = [each for each in resets if until is not None and until - each.time < RESET_S][-1:]
    failed = [
        each
        for k, each in enumerate(resets)
        if each not in worked and (k + 1 < len(resets) or each.time + RESET_S < end)
    ]
    earliest = first.begin - REPORT_BEFORE_S if first is not axis.spans[0] else 0.0
    reported = list(_reports(trace, axis, earliest, first.begin, end))
    texts = list(dict.fromkeys(each.text for each in reported))
    texts = [each for each in texts if not any(each in other for other in texts if other != each)]
    words = "; ".join(texts) or "no cause reported"
    code = next((each.code for each in reported if each.code), 0)
    how = "in fault" if first is not axis.spans[0] else "already in fault when first seen"
    how += f" {trace.lasting(first.begin, until)}"
    if until is not None:
        how += f", then {'reset' if worked else 'left without a reset of its own'}"
    elif axis.controls and not resets:
        how += ", never reset"
    frames = (first.frame, *(each.frame for each in reported), *(each.frame for each in resets))
    yield Finding(
        code="drive-fault",
        severity=severity_at_end(until),
        time=first.begin,
        until=until,
        node=axis.node,
        axis=axis.number,
        text=f"{how}: {words}",
        motion=coasting(trace, axis.node, axis.number, first.begin, end),
        frames=tuple(sorted(set(frames))),
        seen=causes_of_error(code),
    )
    if failed and trace.timed:
        yield Finding(
            code="reset-failed",
            severity=severity_at_end(until),
            time=failed[0].time,
            until=until,
            node=axis.node,
            axis=axis.number,
            text=f"{plural(len(failed), 'fault reset')} without effect",
            frames=tuple(each.frame for each in failed),
        )


def rising(changes: Sequence[Change], bit: int) -> list[Change]:
    """Where a bit of a word is set; at its first value only if it is known to have been unset."""
    return [now for before, now in pairwise(changes) if now.value & bit and not before.value & bit]


class Report(NamedTuple):
    """What a drive reports of a fault, in words; its error code, 0 for none; and the frame."""

    text: str
    code: int
    frame: int


def _reports(
    trace: Conversation, axis: Axis, soon: float, begin: float, end: float
) -> Iterator[Report]:
    """What a drive reports of a fault between two times in s, from some time before on."""
    late = min(begin + REPORT_AFTER_S, end)
    for each in trace.observed.emergencies:
        if each.node == axis.node and each.code and soon <= each.time <= late:
            yield Report(each.words, each.code, each.frame)
    key = key_of_axis(ERROR_CODE, axis.number)
    for code in trace.observed.changes.get((axis.node, key), ()):
        if code.value and soon <= code.time <= end:
            yield Report(trace.objects.words(axis.node, key, code.value), code.value, code.frame)
    for transfer in trace.observed.transfers:
        read = transfer.good and not transfer.writes and transfer.key[0] == FAULTS
        if read and transfer.node == axis.node and soon <= transfer.begin <= end:
            number = transfer.value if transfer.key[1] and trace.objects.is_akd(axis.node) else None
            if number:
                yield Report(protocol.fault_words([number]), 0, transfer.frames[-1])


def has_torque(trace: Conversation, time: float, node: int = BUS) -> bool:
    """Whether a drive is enabled at a time in s.

    Args:
        trace: The trace.
        time: The time.
        node: Which drive; ``BUS`` for any.
    """
    spans = (axis.span_at(time) for axis in axes(trace) if node in (BUS, axis.node))
    return any(each is not None and each.state is DriveState.OPERATION_ENABLED for each in spans)
