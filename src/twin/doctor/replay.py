"""The frames of a host in a trace, sent again to emulated drives: where their answers differ.

The drives begin with the values that their objects had before they were written. There is no plate.
"""

from __future__ import annotations

import re
from array import array
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from twin.base.errors import LogError, plural
from twin.devices.akd import protocol
from twin.devices.akd.config import AkdConfig
from twin.devices.akd.decoding import HOST, Conversation, TracedEvent
from twin.devices.akd.object_names import PLACE, SPEED, Names
from twin.devices.akd.pdo_table import Series
from twin.devices.akd.trace_files.frames import BusFrame
from twin.emulator.can_bus import EmulatedBus
from twin.emulator.direct_bus import message
from twin.emulator.drive import EmulatedDrive
from twin.emulator.drive_objects import AbortError, Frame

MAX_DRIVE_STEP_S = 0.001
"""Longest step of the drives in s."""


@dataclass(frozen=True, kw_only=True)
class ReplayTolerances:
    """Differences between a trace and its replay that are none.

    Attributes:
        time_s: Time in s by which a frame may be earlier or later.
        pdos: Number of PDOs by which a value may be earlier or later.
        position_rad: Motor position since the first PDO, rad.
        speed_rad_s: Motor speed, rad/s.
    """

    time_s: float = 0.1
    pdos: int = 5
    position_rad: float = 0.1
    speed_rad_s: float = 0.05

    @property
    def by_object(self) -> dict[int, float]:
        """The tolerance of each object of a motor, by its index: rad or rad/s."""
        return {PLACE: self.position_rad, SPEED: self.speed_rad_s}


REPLAY_TOLERANCES = ReplayTolerances()
_HEX_SUFFIX = re.compile(r" \([0-9A-F]+h\)$")
"""The bits of a status word at the end of its text."""
_MISSING_OBJECT = re.compile("code 060(20000|90011)h")
"""Text of an abort because the drive has no such object."""
_MOVING_OBJECT = re.compile("reads (606[2-4C]|60[EF]4|2050)h")
"""Text of a read of a quantity that changes while a motor turns."""
_SERVICES_BY_KIND = {
    "SDO": protocol.SDO_RESPONSE,
    "EMCY": protocol.EMERGENCY,
    "heartbeat": protocol.HEARTBEAT,
}


class Replay(NamedTuple):
    """The result of a replay.

    Attributes:
        sent: Number of frames of the host that were sent again.
        compared: Number of frames of drives that were compared.
        remarks: Parts of the trace that could not be replayed, in a line each.
        difference: The first one; None if the emulated drives answer the same.
    """

    sent: int
    compared: int
    remarks: list[str]
    difference: TracedEvent | None


def replay(
    frames: Sequence[BusFrame],
    names: Names,
    rig: AkdConfig | None,
    tolerances: ReplayTolerances = REPLAY_TOLERANCES,
) -> Replay:
    """Send the frames of a host to emulated drives, in order and time, and compare the answers.

    Of PDOs the states and changes are compared, the position and speed of the motor, and their
    number.

    Args:
        frames: The trace.
        names: Names of objects.
        rig: Configuration of the drives, if known.
        tolerances: Differences that are none.

    Raises:
        LogError: If no drive of it can be emulated.
    """
    recorded = Conversation(frames, names, rig)
    remarks, drives = list[str](), dict[int, EmulatedDrive]()
    for number, node in recorded.nodes.items():
        vendor = recorded.objects.values[number].get((0x1018, 1), protocol.AKD_VENDOR_ID)
        if vendor != protocol.AKD_VENDOR_ID:
            remarks.append(f"{node.name}: no AKD, its vendor is {vendor:X}h: not replayed")
        elif node.frames.keys() - {"heartbeat", "guard answer"}:
            drives[number] = EmulatedDrive(number)
    if not drives:
        raise LogError("; ".join(remarks) or "no drive sends anything, so nothing can be replayed")
    _prepare(drives, frames)
    readable = [each for each in frames if not each.is_error_frame and not each.is_extended_id]
    theirs = {each + number for each in _SERVICES_BY_KIND.values() for number in recorded.nodes} - {
        protocol.HEARTBEAT + number for number, node in recorded.nodes.items() if not node.transfers
    }
    theirs |= {each for each, pdo in recorded.pdos.items() if pdo.name[0] == "T"}
    sent = [each for each in readable if each.arbitration_id not in theirs]
    heard = _replay_answers(drives, sent, frames[0].timestamp)
    replayed = Conversation(heard, names, rig)
    events = _compare_events(recorded, replayed, drives, remarks, tolerances.time_s)
    found = [*events, *_compare_motors(recorded, replayed, drives, tolerances)]
    compared = sum(sum(recorded.nodes[each].frames.values()) for each in drives)
    return Replay(len(sent), compared, remarks, min(found, default=None))


def _prepare(drives: dict[int, EmulatedDrive], frames: Sequence[BusFrame]) -> None:
    """Set the objects of drives to the values first read of them, unless they were written."""
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
    """The frames of the host, and the answers of emulated drives, which are on already."""
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


def _compare_events(
    recorded: Conversation,
    replayed: Conversation,
    drives: Collection[int],
    remarks: list[str],
    max_shift_s: float,
) -> Iterator[TracedEvent]:
    """The first event that differs, for each node and kind."""
    one, other = (_streams(each, drives, max_shift_s) for each in (recorded, replayed))
    off, end = replayed.begin - recorded.begin, recorded.duration - max_shift_s
    lacking = list[str]()
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
                or (there == answer and abs(later) <= max_shift_s)
            ):
                continue
            if _MISSING_OBJECT.search(answer) and not _MISSING_OBJECT.search(there):
                lacking.append(there)
                continue
            shown = answer if there != answer else f"the same, {1e3 * later:+.0f} ms later"
            service = _SERVICES_BY_KIND.get(kind)
            where = f"{service + number:03X}h: " if service is not None else ""
            text = f"{where}{there}; emulated: {shown}"
            yield TracedEvent(since, recorded.called(number), kind, text)
            break
    if lacking:
        remarks.append(f"no emulated drive has: {plural(len(lacking), 'object')}, as: {lacking[0]}")


def _streams(
    conversation: Conversation, drives: Collection[int], max_shift_s: float
) -> defaultdict[tuple[int, str], list[TracedEvent]]:
    """Events by node and kind, those of drives that are emulated."""
    found = defaultdict[tuple[int, str], list[TracedEvent]](list)
    for event in conversation.events:
        node = re.search(r"node (\d+)", f"{event.who} {event.text}")
        answers = event.kind in _SERVICES_BY_KIND or (event.kind == "PDO" and event.who != HOST)
        if answers and node and int(node[1]) in drives:
            stream = found[int(node[1]), event.kind]
            if event.kind == "heartbeat" and stream and event.time - stream[-1].time < max_shift_s:
                stream.pop()  # whether a short state is seen depends on when heartbeats are sent
            if stream or event.text != protocol.nmt_words(0):  # it is on when the trace begins
                stream.append(event)
    return found


def _compare_motors(
    recorded: Conversation,
    replayed: Conversation,
    drives: Collection[int],
    tolerances: ReplayTolerances,
) -> Iterator[TracedEvent]:
    """Where PDOs are missing, or report a different motion of the motor."""
    sent = ((at, pdo, key) for at, pdo in recorded.pdos.items() for key, _ in pdo.entries)
    for cob_id, pdo, key in sent:
        if pdo.node not in drives or pdo.name[0] == "R":
            continue
        a, b = (
            each.series.get((pdo.node, key), Series(array("d"), array("q")))
            for each in (recorded, replayed)
        )
        count, (factor, unit) = min(len(a.time), len(b.time)), recorded.objects.scale(pdo.node, key)
        found: list[tuple[int, str, str]] = []
        if abs(len(a.time) - len(b.time)) > tolerances.pdos:
            off = np.subtract(a.time[:count], b.time[:count]) + recorded.begin - replayed.begin
            usual = np.median(np.diff(b.time)) if count > 1 else 0.0
            last = np.flatnonzero(np.abs(off) < usual / 2)[-1:]
            found.append((int(last.sum()), f"{len(a.time)} in all", f"{len(b.time)}"))
        near = tolerances.by_object.get(key[0])
        if near is not None and unit and count:
            both = (
                np.unwrap(np.array(each.counts[:count], float), period=2.0**32) for each in (a, b)
            )
            x, y = (factor * (each - (key[0] == PLACE) * each[0]) for each in both)
            wide = 2 * tolerances.pdos + 1
            low, high = minimum_filter1d(x, wide) - near, maximum_filter1d(x, wide) + near
            for k in np.flatnonzero((y < low) | (y > high))[:1].tolist():
                own = f"{recorded.objects.name(pdo.node, key)} {x[k]:.6g} {unit}"
                found.append((k, own, f"{y[k]:.6g} {unit}"))
        for k, own, other in found:
            text = f"{cob_id:03X}h {pdo.name}: {own}; emulated: {other}"
            at = a.time[k] if a.time else 0.0
            yield TracedEvent(at, recorded.called(pdo.node), "PDO", text)
