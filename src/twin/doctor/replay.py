"""What a host said in a trace, said again to emulated drives: where they answer otherwise.

They begin with what their objects were read to hold before these were written. There is no plate.
"""

from __future__ import annotations

import re
from array import array
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from twin.base.errors import LogError
from twin.devices.akd import protocol
from twin.devices.akd.config import AkdConfig
from twin.devices.akd.decoding import (
    AKD,
    HOST,
    PLACE,
    SPEED,
    Conversation,
    Names,
    Series,
    TracedEvent,
)
from twin.devices.akd.trace_files.frames import BusFrame
from twin.emulator.can_bus import EmulatedBus, message
from twin.emulator.drive import EmulatedDrive
from twin.emulator.drive_objects import AbortError, Frame

MAX_DRIVE_STEP_S = 0.001
"""Longest step of the drives in s."""
MAX_TIME_SHIFT_S, MAX_PDO_SHIFT = 0.1, 5
"""Time in s, and PDOs, by which something may come earlier or later."""
MOTOR_TOLERANCES = {PLACE: 0.1, SPEED: 0.05}
"""By how much what is said of a motor may differ: position since the first PDO in rad, rad/s."""
_HEX_SUFFIX = re.compile(r" \([0-9A-F]+h\)$")
_MISSING_OBJECT = re.compile("code 060(20000|90011)h")
_MOVING_OBJECT = re.compile("reads (606[2-4C]|60[EF]4|2050)h")
"""How of a status word its bits are told, that there is no such object, reading what moves."""
_DRIVE_SERVICES = {
    "SDO": protocol.SDO_RESPONSE,
    "EMCY": protocol.EMERGENCY,
    "heartbeat": protocol.HEARTBEAT,
}


class Replay(NamedTuple):
    """What came of it.

    Attributes:
        sent: Frames of the host that were sent again.
        compared: Frames of drives that were compared.
        remarks: What could not be replayed, in a line each.
        difference: The first one; None if the emulated drives answer the same.
    """

    sent: int
    compared: int
    remarks: list[str]
    difference: TracedEvent | None


def replay(frames: Sequence[BusFrame], names: Names, rig: AkdConfig | None) -> Replay:
    """Send what a host sent to emulated drives, in its order and time, and compare the answers.

    Of PDOs the states and changes are compared, what they say of the motor, and their number.

    Args:
        frames: The trace.
        names: What objects are called.
        rig: Whose drives they are.

    Raises:
        LogError: If no drive of it can be emulated.
    """
    said = Conversation(frames, names, rig)
    remarks, drives = list[str](), dict[int, EmulatedDrive]()
    for number, node in said.nodes.items():
        vendor = said.values[number].get((0x1018, 1), AKD)
        if vendor != AKD:
            remarks.append(f"{node.name}: no AKD, its vendor is {vendor:X}h: not replayed")
        elif node.frames.keys() - {"heartbeat"}:
            drives[number] = EmulatedDrive(number)
    if not drives:
        raise LogError("; ".join(remarks) or "no drive says anything: there is nothing to replay")
    _prepare(drives, frames)
    told = [each for each in frames if not each.is_error_frame and not each.is_extended_id]
    theirs = {each + number for each in _DRIVE_SERVICES.values() for number in said.nodes} - {
        protocol.HEARTBEAT + number for number, node in said.nodes.items() if not node.transfers
    }
    theirs |= {each for each, pdo in said.pdos.items() if pdo.name[0] == "T"}
    sent = [each for each in told if each.arbitration_id not in theirs]
    heard = _replay_answers(drives, sent, frames[0].timestamp)
    answered = Conversation(heard, names, rig)
    found = [*_events(said, answered, drives, remarks), *_numbers(said, answered, drives)]
    compared = sum(sum(said.nodes[each].frames.values()) for each in drives)
    return Replay(len(sent), compared, remarks, min(found, default=None))


def _prepare(drives: dict[int, EmulatedDrive], frames: Sequence[BusFrame]) -> None:
    """Let drives hold what they are first read to hold, unless it was written before."""
    known = set[tuple[int, int, int]]()
    for frame in frames:
        number, data = frame.arbitration_id & protocol.NODE_MASK, bytes(frame.data)
        service = frame.arbitration_id - number
        answer = protocol.decode_sdo(data) if service == protocol.SDO_RESPONSE else None
        if answer is None or number not in drives or (number, *answer.key) in known:
            continue
        known.add((number, *answer.key))
        store = drives[number].store
        if answer.data and not answer.aborted:
            with suppress(AbortError):  # it has no such object
                signed = store.find(*answer.key).signed
                store.set(*answer.key, int.from_bytes(answer.data, "little", signed=signed))


def _replay_answers(
    drives: dict[int, EmulatedDrive], sent: Sequence[BusFrame], begin: float
) -> list[BusFrame]:
    """What the host sent, and what emulated drives answer, which are on already."""
    bus = EmulatedBus(list(drives.values()))
    bus.step(MAX_DRIVE_STEP_S)
    bus.to_host()
    heard, off = list[BusFrame](), begin - bus.time

    def take() -> None:
        for each in bus.to_host():
            heard.append(message(each.cob_id, each.data))
            heard[-1].timestamp = bus.time + off

    for frame in sent:
        while (left := frame.timestamp - off - bus.time) > 1e-9:
            bus.step(min(left, MAX_DRIVE_STEP_S))
            take()
        heard.append(frame)
        bus.from_host(Frame(frame.arbitration_id, bytes(frame.data), frame.is_remote_frame))
        take()
    return heard


def _events(
    said: Conversation, answered: Conversation, drives: Collection[int], remarks: list[str]
) -> Iterator[TracedEvent]:
    """Of each node and kind the first event that differs."""
    one, other = (_streams(each, drives) for each in (said, answered))
    off, end, lacking = answered.begin - said.begin, said.duration - MAX_TIME_SHIFT_S, list[str]()
    for number, kind in sorted(one.keys() | other.keys()):
        for a, b in zip_longest(one[number, kind], other[number, kind]):
            since = min(a.time if a else np.inf, b.time + off if b else np.inf)
            there, answer = (
                _HEX_SUFFIX.sub("", each.text) if each else "nothing" for each in (a, b)
            )
            later = b.time + off - a.time if a and b else 0.0
            if (
                since > end
                or _MOVING_OBJECT.match(there)
                or (there == answer and abs(later) <= MAX_TIME_SHIFT_S)
            ):
                continue
            if _MISSING_OBJECT.search(answer) and not _MISSING_OBJECT.search(there):
                lacking.append(there)
                continue
            told = answer if there != answer else f"the same, {1e3 * later:+.0f} ms later"
            where = f"{_DRIVE_SERVICES[kind] + number:03X}h: " if kind in _DRIVE_SERVICES else ""
            text = f"{where}{there}; emulated: {told}"
            yield TracedEvent(since, said.called(number), kind, text)
            break
    if lacking:
        remarks.append(f"no emulated drive has: {len(lacking)} objects, as: {lacking[0]}")


def _streams(
    said: Conversation, drives: Collection[int]
) -> defaultdict[tuple[int, str], list[TracedEvent]]:
    """Events by node and kind, those of drives that are emulated."""
    found = defaultdict[tuple[int, str], list[TracedEvent]](list)
    for event in said.events:
        node = re.search(r"node (\d+)", f"{event.who} {event.text}")
        answers = event.kind in _DRIVE_SERVICES or (event.kind == "PDO" and event.who != HOST)
        if answers and node and int(node[1]) in drives:
            stream = found[int(node[1]), event.kind]
            if (
                event.kind == "heartbeat"
                and stream
                and event.time - stream[-1].time < MAX_TIME_SHIFT_S
            ):
                stream.pop()  # a state that is short is seen or not, as heartbeats come
            if stream or event.text != protocol.nmt_words(0):  # it is on when the trace begins
                stream.append(event)
    return found


def _numbers(
    said: Conversation, answered: Conversation, drives: Collection[int]
) -> Iterator[TracedEvent]:
    """Where PDOs are missing, or say something else of the motor."""
    sent = ((at, pdo, key) for at, pdo in said.pdos.items() for key, _ in pdo.entries)
    for cob_id, pdo, key in sent:
        if pdo.node not in drives or pdo.name[0] == "R":
            continue
        a, b = (
            each.series.get((pdo.node, key), Series(array("d"), array("q")))
            for each in (said, answered)
        )
        count, (factor, unit) = min(len(a.time), len(b.time)), said.scale(pdo.node, key)
        found: list[tuple[int, str, str]] = []
        if abs(len(a.time) - len(b.time)) > MAX_PDO_SHIFT:
            off = np.subtract(a.time[:count], b.time[:count]) + said.begin - answered.begin
            usual = np.median(np.diff(b.time)) if count > 1 else 0.0
            last = np.flatnonzero(np.abs(off) < usual / 2)[-1:]
            found.append((int(last.sum()), f"{len(a.time)} in all", f"{len(b.time)}"))
        if key[0] in MOTOR_TOLERANCES and unit and count:
            both = (
                np.unwrap(np.array(each.counts[:count], float), period=2.0**32) for each in (a, b)
            )
            x, y = (factor * (each - (key[0] == PLACE) * each[0]) for each in both)
            near, wide = MOTOR_TOLERANCES[key[0]], 2 * MAX_PDO_SHIFT + 1
            low, high = minimum_filter1d(x, wide) - near, maximum_filter1d(x, wide) + near
            for k in np.flatnonzero((y < low) | (y > high))[:1].tolist():
                own = f"{said.object_name(pdo.node, key)} {x[k]:.6g} {unit}"
                found.append((k, own, f"{y[k]:.6g} {unit}"))
        for k, own, other in found:
            text = f"{cob_id:03X}h {pdo.name}: {own}; emulated: {other}"
            yield TracedEvent(a.time[k] if a.time else 0.0, said.called(pdo.node), "PDO", text)
